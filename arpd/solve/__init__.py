"""The DEPTH/DEADLINE program and its back ends."""

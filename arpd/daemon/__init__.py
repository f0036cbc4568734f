"""The daemon: its tick, and the loops that run it in real and in virtual time."""

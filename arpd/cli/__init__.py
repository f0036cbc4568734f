"""The `arpd` command."""

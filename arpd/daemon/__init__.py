"""The daemon: its tick, and how it runs in real and in virtual time."""

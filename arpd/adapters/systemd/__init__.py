"""systemd: notify protocol and journal."""

"""The host as arpd sees it: link counters and memory."""

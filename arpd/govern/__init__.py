"""Governor: turns what the link carries into a budget, and lasting changes into plans."""

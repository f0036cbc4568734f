"""A relay with two ends, one on each side of the link: pure."""

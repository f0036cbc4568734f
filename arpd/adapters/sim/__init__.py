"""A robot and its link in virtual time, for fast scenarios."""

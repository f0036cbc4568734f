"""A robot, its link and its peer in virtual time, for fast scenarios."""

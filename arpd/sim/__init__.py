"""A simulated link: network namespaces for real processes, virtual time for fast scenarios."""

"""Rmax: the capacity of the link, from counters, receiver reports and probe trains."""

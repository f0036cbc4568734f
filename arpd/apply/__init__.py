"""Ordered steps from a plan, and the endpoints that carry them out."""

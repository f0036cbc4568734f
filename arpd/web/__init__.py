"""HTTP: metrics, status, page."""

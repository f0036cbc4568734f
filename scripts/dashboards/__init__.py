"""Writes the Grafana dashboards of etc/grafana/dashboards."""

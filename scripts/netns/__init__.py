"""Two hosts joined by one slow link inside this machine, as network namespaces."""

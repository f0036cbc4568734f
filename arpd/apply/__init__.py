"""From a plan to ordered steps, and to the writers and readers that carry them out."""

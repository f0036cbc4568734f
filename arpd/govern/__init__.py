"""Governor: turns measured changes into a gate, a level and a plan."""

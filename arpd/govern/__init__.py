"""When a measured change becomes action: the gate, the level, the plan."""

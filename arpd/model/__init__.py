"""The frozen values that every stage speaks in: base SI units, units in names."""

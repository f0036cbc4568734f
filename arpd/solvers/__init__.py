"""Back ends for the DEPTH/DEADLINE program, one module each."""

"""One adaptive endpoint: pacing, and the make-before-break swap of its writer or reader."""

"""One endpoint: its pacing, and the swap of its writer or reader."""

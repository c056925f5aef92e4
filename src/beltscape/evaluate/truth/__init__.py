"""Ground truth of simulated scenes: its files, occluded pixels, and resampling to another core camera."""

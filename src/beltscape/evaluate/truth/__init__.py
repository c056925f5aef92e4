"""Ground truth of simulated scenes: its files, the empty belt, occluded pixels, resampling to another core camera."""

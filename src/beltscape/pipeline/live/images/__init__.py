"""References learned from the images and kept over restarts: those of the cameras, the pattern of the projector."""

"""What is learned of the images, kept over restarts: references of the cameras, the pattern of the projector."""

"""The truth of a simulated capture: depth, visibility, volumes and dimensions."""

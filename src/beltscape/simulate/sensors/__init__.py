"""Other sensors over the same belt: fringe projection, line laser and LiDAR scanner."""

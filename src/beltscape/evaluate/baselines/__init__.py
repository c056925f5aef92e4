"""Other ways to measure a surface, simulated: structured light, a line laser, a LiDAR scanner."""

"""Simulated baseline sensors to compare with: structured light, a line laser and a LiDAR scanner."""

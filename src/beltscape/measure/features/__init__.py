"""A calibration module in one depth map: its pose, and the dimensions of its features."""

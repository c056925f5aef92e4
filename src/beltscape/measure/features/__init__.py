"""A calibration module in one depth map: where it lies, and how large its features are."""

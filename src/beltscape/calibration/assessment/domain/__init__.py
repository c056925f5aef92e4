"""Domain of calibrated lenses: the part of each image that the board reached."""

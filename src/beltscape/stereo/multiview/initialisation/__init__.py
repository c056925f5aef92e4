"""The first surface of a frame: from the previous frame where that fits, from a plane sweep elsewhere."""

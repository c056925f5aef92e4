"""The first surface of a frame: from the frame before where that still fits, from a plane sweep elsewhere."""

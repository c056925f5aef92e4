"""The first surface of a frame, from a plane sweep over the given or a found depth range."""

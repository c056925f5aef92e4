"""A sequence of frames: the next ones are matched and the last ones written while one is measured."""

"""Improvement of a surface: propagation near depth steps, dense least squares, twicing, textureless regions."""

"""Sigma and probability of every pixel of a matched surface, predicted by networks from its features.

The data flow one way: `inputs` (the surface and its fits without NaN) → `features` → the networks →
`refiner` (uncertain pixels) → `correlated_noise` (sigma). `estimate` is the entrance.
`image_features` are those of the image alone, computed while the surface is optimised.
"""

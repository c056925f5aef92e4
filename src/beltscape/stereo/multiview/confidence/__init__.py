"""Sigma and probability of every pixel of a matched surface, predicted by networks from its features.

The data flow one way: `features` (of the surface and its fits) → `refined_features` (after candidate selection) →
the networks and the refinement of uncertain pixels (`estimate`, the entrance) → `correlated_noise` (sigma).
`image_features` are those of the image alone, computed while the surface is optimised.
"""

"""Confidence and σ of every pixel: features, the networks that weigh them, and the refinement of uncertain pixels."""

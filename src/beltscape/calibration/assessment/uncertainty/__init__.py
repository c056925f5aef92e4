"""Uncertainty of an adjusted rig: covariance, jackknife over board positions, and the next-best view."""

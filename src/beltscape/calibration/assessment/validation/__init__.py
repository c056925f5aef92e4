"""Validation of a rig on board views: residuals, folds without leaks, held-out scores, noise of the corners."""

"""How good a rig is: scores on held-out views, covariance, jackknife, the next best view."""

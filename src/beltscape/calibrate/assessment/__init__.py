"""Assessment of a rig: scores on held-out views, covariance, jackknife, findings, the next-best view."""

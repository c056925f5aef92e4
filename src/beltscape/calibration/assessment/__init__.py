"""Assessment of a rig: held-out scores, covariance, jackknife, findings, verdict, left-out views, next-best view."""

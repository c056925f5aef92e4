"""Assessment of a rig: held-out scores, covariance, jackknife, findings, verdict, what was left out, next-best view."""

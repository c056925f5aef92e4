"""Several frames of the same stretch of belt fused into rows of heights."""

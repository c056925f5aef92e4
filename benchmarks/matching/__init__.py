"""Benchmarks of the matcher: kernels, methods, whole frames, and degraded images."""

"""Benchmarks of the matcher: kernels, methods, whole frames, degraded images, real pairs; speed beside OpenCV."""

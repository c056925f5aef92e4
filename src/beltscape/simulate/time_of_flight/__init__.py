"""A time-of-flight camera: rays, phases, multipath and noise."""

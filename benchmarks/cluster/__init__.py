"""Re-processing on a cluster: measured with one and two workers, simulated with more."""

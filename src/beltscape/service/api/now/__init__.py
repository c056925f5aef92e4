"""What is so now: state, cameras' last images, the stream to open pages, metrics for Prometheus."""

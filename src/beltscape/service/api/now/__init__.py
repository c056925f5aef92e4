"""The present state: values, cameras' last images, the stream to open pages, metrics for Prometheus."""

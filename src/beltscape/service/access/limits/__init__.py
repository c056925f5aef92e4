"""Limits against overload and guessing: throttling, queues, connections."""

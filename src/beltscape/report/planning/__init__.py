"""The plan's report."""

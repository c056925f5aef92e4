"""The report page of the paper's experiments."""

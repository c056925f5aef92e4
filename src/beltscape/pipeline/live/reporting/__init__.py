"""Reports of the running system: events and findings for the history, warnings without repetition."""

"""Records, series and events read back from database and day files."""

"""What the manual tells its readers to type, typed."""

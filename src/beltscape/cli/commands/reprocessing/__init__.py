"""Commands that measure recordings again and compare the results."""

"""Commands that turn captures into depth and measure it."""

"""Text, JSON and TOML."""

"""Documents: reading and writing of plain text, JSON and TOML."""

"""The HTTP interface: one module of endpoints per subject."""

"""Writers of figures."""

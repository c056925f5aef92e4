"""Where frame sets come from."""

"""Flow on a moving belt: volume and mass of the passing load, strip by strip."""

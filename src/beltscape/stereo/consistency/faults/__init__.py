"""The camera whose images no longer fit the rig: isolated by its residuals, and the change of its pose."""

"""Types of the SciPy functions that this project calls; SciPy itself has none."""

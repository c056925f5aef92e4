"""Actions of operators and engineers: the belt's zero, and maintenance."""

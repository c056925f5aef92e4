"""Frame sets on their way from the cameras: the queue before the worker, and the exposure times."""

"""One camera: the Aravis library, the opened device, its features, and the threads that keep it open."""

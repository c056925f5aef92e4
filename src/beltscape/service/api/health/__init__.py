"""Health, for engineers: the system's checks of itself, its learned images, the zero of the empty belt."""

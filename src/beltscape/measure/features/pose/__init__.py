"""The module's pose in a depth map, and the solids it consists of."""

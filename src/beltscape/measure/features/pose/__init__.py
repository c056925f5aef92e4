"""The pose of the module in a depth map, and the solids that it consists of."""

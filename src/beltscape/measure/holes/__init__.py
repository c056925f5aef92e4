"""Occlusion holes: heights predicted for cells that no camera measured, from the cells around them."""

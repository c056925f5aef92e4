"""Places that no camera measured, told by what is measured about them."""

"""Detection of the board's corners: in images, to a hundredth of a pixel, with a check of the described board."""

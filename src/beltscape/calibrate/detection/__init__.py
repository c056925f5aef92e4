"""The board's corners: found in images, refined to a hundredth of a pixel, checked against the described board."""

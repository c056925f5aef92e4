"""Views of a board: captures of images or frames of videos, and the boards detected in them."""

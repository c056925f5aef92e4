"""OpenCV's utilities, as far as this project uses them."""

from . import logging as logging

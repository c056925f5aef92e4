"""Lumps: the top layer of a load told apart rock by rock on its depth, with size, distribution and alarm."""

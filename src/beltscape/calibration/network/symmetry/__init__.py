"""Boards that look the same after a turn: their corners numbered from the same end in all cameras."""

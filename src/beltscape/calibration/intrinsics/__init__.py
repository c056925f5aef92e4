"""Intrinsics of one camera by Zhang's method, and their sensitivity to the corners."""

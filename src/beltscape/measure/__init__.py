"""Depth → belt frame, heights, profiles, volume."""

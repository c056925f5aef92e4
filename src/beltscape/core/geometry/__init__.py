"""Rigid transforms named by their frames, the lens model, cameras and rigs, and their change of image size."""

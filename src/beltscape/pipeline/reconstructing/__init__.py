"""Reconstruction and rectification of captures, with a consistency check of the cameras.

`reconstruction` is the entrance of `reconstruct`, `rectification` of `rectify`: `search_range` finds where the
surface lies, `checked_matcher` matches a frame with the cameras that pass the `camera_checks`, and `sequence` matches
and writes others meanwhile, by a `match_pool`. `monitored_matcher` matches the frames of a running system.
"""

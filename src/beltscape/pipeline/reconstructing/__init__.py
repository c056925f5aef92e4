"""Reconstruction and rectification of captures, with a consistency check of the cameras.

`reconstruction` is the entrance of `reconstruct`, `rectification` of `rectify`: `search_range` finds where
the surface lies, `checked_matcher` matches a frame with the cameras that pass the `camera_checks`,
`monitored_matcher` with those whose images pass their checks, `match_ahead` matches the next ones and
`frame_writer` writes the last ones meanwhile. `cloud_export` gives a frame's cloud to other programs.
"""

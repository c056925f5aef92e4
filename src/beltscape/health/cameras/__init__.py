"""Checks of the cameras' poses: the residuals of tie points against the rig, and how many auxiliaries contribute.

`poses` turns a `RigConsistency` into one finding per camera, in mm of depth; `redundancy` counts the auxiliaries that
measure. The schedule of the checks and the exclusion of cameras are in `pipeline.reconstructing.checked_matcher`.
"""

"""Calibration of captures, and checks of rigs on views that they were not calibrated with.

`views` of the board, `intrinsics` of single cameras, `board_sets` of several boards, then `calibration` of
the rig in its `measuring_volume`, written by `calibration_files`. `extension` adds cameras to a rig, `check`
tries one on new views.
"""

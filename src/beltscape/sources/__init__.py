"""Sources of frame sets: capture folders, replayed captures, GenICam cameras; and the belt's encoder.

`folder` reads a capture, `replay` plays it as a live source, `genicam` has the cameras and `fake_genicam`
simulated ones; `encoder` gives the belt's position.
"""

"""Boards with several faces: the poses of the faces relative to each other, and views from behind.

`face_poses` gives a rigid set of faces its poses, `face_adjustment` refines them; `two_sides` does so for a board
printed on both sides; `back_views` finds cameras that see a board mirrored.
"""

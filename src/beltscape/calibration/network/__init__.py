"""The network of cameras: each camera that sees a board is connected to the others by common views.

`pairs` calibrates two cameras, `pose_chains` and `association` choose the way from each camera to the core,
`global_optimisation` refines all poses together, `fault_isolation` names what does not fit. Before them,
`synchronisation` and `board_symmetry` bring the views of all cameras to the same instants and corners;
`face_poses` and `two_sides` are for boards with several faces. `resection` finds a board in a finished rig.
"""

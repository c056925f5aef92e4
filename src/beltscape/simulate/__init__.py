"""The simulator: rendered captures of a plant with exact truth.

`scenario` describes a scene; `scene_assembly` makes its objects and images from `solids` (meshes of `shapes`
in a `world`) and `rig_and_projector`, and yields frames without files; `rendering` renders them, `faults`
disturb them. `core_truth` traces the exact depth by `ray_casting`, `truth_files` writes it.
`profile_scanners`, `projected_sequence` and `time_of_flight` (of `time_of_flight_signal`) are other devices
over the same belt.
"""

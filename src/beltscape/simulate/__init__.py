"""The simulator: rendered captures of a plant with exact truth.

`scenario` describes a scene; `scene_assembly` makes its objects and images from `solids` (meshes of `geometry`),
`rig_and_projector` and `board_poses`; `rendering` renders them; `truth` traces the exact depth; `sensors` and
`time_of_flight` are other devices over the same belt; `source` yields frames without files.
"""

"""Planning of a rig before it is built: camera positions, coverage, precision, light and motion.

`plan` is the entrance: from the `settings` follow the `mounting` height, the `baseline` (precision against
`occlusion`), the `planned_rig`, its `coverage` by `footprint` and its `precision`, then what a moving belt requires
of exposure (`motion`) and light. `document` writes it as plain values.
"""

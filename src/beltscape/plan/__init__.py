"""Planning of a rig before it is built: camera positions, coverage, precision, light and motion.

`plan` is the entrance: from the `settings` follow the mounting height, the `baseline` (precision against
occlusion), the `planned_rig` with its precision, its `coverage`, then what a moving belt requires of exposure
and `light`.
"""

"""Planning of a rig before it is built: camera positions, coverage, precision, light and motion."""

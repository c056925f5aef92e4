"""A rig before it exists: where cameras go, what they will see and how well."""

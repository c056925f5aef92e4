"""Protocols of a project: `serving` starts them beside the running system; `checks` and `users` are for it."""

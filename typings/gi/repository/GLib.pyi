"""GLib's errors."""

class Error(Exception):
    message: str

"""OpenCV's own log, as far as this project uses it."""

LOG_LEVEL_SILENT: int

def setLogLevel(level: int) -> int: ...

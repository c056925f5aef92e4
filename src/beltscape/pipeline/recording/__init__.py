"""Recording of captures from the cameras of a project.

`project` reads its tables, `trigger` says when a shot is due, `feed` brings the newest frame sets, `shots` and
`sequence` write them.
"""

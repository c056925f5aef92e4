"""Recording of captures from the cameras of a project.

`project` reads its tables, `feed` brings the newest frame sets and writes all of them, `shots` writes single
ones.
"""

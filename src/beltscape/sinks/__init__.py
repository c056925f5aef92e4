"""Destinations of finished records and raw frames: the `historian`, tables of the `csv_sink`, recordings.

`recorder` writes raw frame sets while the system runs, `recording` is a capture on the disk. `days` assigns
times to days; `settings` are the tables of project.toml.
"""

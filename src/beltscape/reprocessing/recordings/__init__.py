"""Recordings of a source: finding them in folders, archives and buckets, and reading their frames.

`discovery` walks the source through `tree` (folders or archives) and makes `recording` objects by
`capture_files`; a recording yields its frame sets on a worker. `storage` is the door to fsspec; `archives`
reads zip and tar by byte ranges: nothing is extracted to disk, and a worker needs no list of an archive's
members.
"""

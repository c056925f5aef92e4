"""The pipeline: the stages joined to whole commands.

Each command has a module or a package: `plan`, `simulation`, `pattern_files`, `view` (and `view_rerun`),
`installation`; `calibrating`, `reconstructing`, `measuring`, `recording` and the running system, `live`.
"""

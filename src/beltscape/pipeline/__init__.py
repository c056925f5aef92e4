"""The pipeline: joins the stages to whole commands (plan, simulate, calibrate, reconstruct, measure, run live).

Each command has a module or a package: `plan`, `simulation`, `pattern_files`, `view`; `calibrating`,
`reconstructing`, `measuring`, `recording`, `installation` and the running system, `live`.
"""

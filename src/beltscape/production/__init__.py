"""Production on a belt: products, their timetable, batches, shifts, and the comparison with a belt scale.

`settings` are the tables of project.toml, `calendar` turns local times into instants for `timetable` and `shifts`,
`sums` adds records up with σ, `batches` and `scale` are made of such sums. Nothing here reads or writes a file.
"""

"""Production on a belt: products, their timetable, batches, shifts, and the comparison with a belt scale.

`settings` are the tables of project.toml, `calendar` turns local times into instants for `shifts`, which has
the timetable too; `sums` adds records up with σ, also those of batches; `scale` is made of such sums. Nothing
here reads or writes a file.
"""

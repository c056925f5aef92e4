"""Uncertainty by the GUM (JCGM 100:2008): the material test of a belt, its certificate, and the budget of a year.

`uncertainty` combines effects to a budget, `repeatability` evaluates repeated runs over several loads,
`material_test` estimates span factor, bulk density and moisture apart from its `observations`, `settings` are the
test's TOML file. `certificate` is the statement with what it applies to, `document` the result for it; `annual` the
budget of the paid tonne. Nothing here reads or writes a file.
"""

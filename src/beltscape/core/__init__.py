"""Shared types of all packages; they import NumPy only.

`geometry` has poses, cameras, lenses and rigs. `frames`, `depth` and `cloud` are frame sets, depth maps and
point clouds; `height_map`, `empty_belt` and `ledger` the belt, its load and its records. Of a running system:
`events`, `alarms`, their catalogue with one row for each (`alarm_catalogue`), `findings`, `translatable_message`, and
the `interfaces` that the packages above implement. Of the process: `system_calls` and `supervision` of its threads.

The other modules are used everywhere: `errors`, `progress`, `display`, `statistics`, `quantities` that people
type, `checks` of values and of callers' `arguments`.
"""

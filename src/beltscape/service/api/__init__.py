"""The HTTP interface: the routes of one subject in each module; `common` is what they share.

`state`, `live_stream` and `metrics`: what is so now. `history`, `export`: any period. `alarms`, `controls`:
what operators do. `health`, `settings`: for engineers. `production`: products, batches, shifts, reports.
"""

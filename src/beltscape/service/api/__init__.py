"""The HTTP interface: the routes of one subject in each module or folder; `common` is what they share.

`now`: state, images, live stream and metrics. `history`, `export`: any period. `alarms`, `controls`: what operators
do. `health`, `settings`: for engineers. `production`, `reports`: products, batches, shifts.
"""

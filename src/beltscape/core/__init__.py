"""Shared types of all packages; they import NumPy only.

`geometry`: transforms, cameras, lenses, rigs. `frames`, `depth`, `cloud`: frame sets, depth maps, point clouds.
`belt`: the empty belt, height maps, records and ledger entries. `live`: events, alarms, findings and interfaces of a
running system. `runtime`: the process. The other modules are used everywhere.
"""

"""OPC UA: state, totals, alarms and history as a server that control systems browse, read and subscribe to.

`address_space`, `types`, `quantities` and `belt` hold the nodes. `certificates` and `sessions` admit clients
and users. `publication` writes values and findings, `conditions` alarms; `commands` carries out methods,
`history` reads records. `server` joins them in a thread of its own.
"""

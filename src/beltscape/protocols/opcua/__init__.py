"""OPC UA: state, totals, alarms and history as a server that control systems browse, read and subscribe to.

`model` holds the nodes: companion types, quantities, units. `security` admits clients and users. `publication` writes
the values, `conditions` the alarms, `findings` the checks; `commands` carries out methods, `history` reads records.
`server` joins them in a thread of its own; `settings` is the table [opcua].
"""

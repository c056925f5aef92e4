"""The running system in the plant's own protocols; each is an extra.

`plant` is all that a protocol sees of the system: its present state and the ledger's records. `mqtt`
publishes them to a broker and loses no record while the broker is away; `modbus` serves the registers of
`modbus_registers`, `opcua` nodes; `outputs` gives `output_pulses` and currents through an I/O module;
`syslog` sends alarms. `settings` are their tables. They share `listening` for servers, `client_tls` for
clients, and the `kept_number`.
"""

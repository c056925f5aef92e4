"""The running system in the plant's own protocols; each is an extra and a package of its own.

`plant` is all that a protocol sees of the system: its present state and the ledger's records. ``mqtt`` publishes them
to a broker and loses no record while the broker is away; ``modbus`` serves registers; ``outputs`` gives pulses and
currents through an I/O module.
"""

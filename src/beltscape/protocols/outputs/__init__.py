"""Outputs to an I/O module by Modbus TCP: pulses and 4 to 20 mA, for counters and control systems without a protocol.

`writer` is the thread that writes, `module` the connection to the I/O module. `pulse_target` says how many pulses are
due since the ledger began, `pulses` gives them as a coil or as a counter, `analogue` turns values into currents,
`settings` is the table [outputs].
"""

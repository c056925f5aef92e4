"""Modbus TCP: the present state, totals and a pulse count as registers that a control system reads.

`registers` is the map, `pulses` the count that survives restarts, `server` answers requests, `settings` is the table
[modbus].
"""

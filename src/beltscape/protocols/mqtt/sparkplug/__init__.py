"""Sparkplug B 3.0 (https://sparkplug.eclipse.org/specification): the belt as a device of an edge node.

`channel` is one session: births, data, the command of rebirth, death. `metrics` are the values of the device,
`payload` is a message of them, `schema` its protocol buffer, and `primary_host` the host for which data wait.
"""

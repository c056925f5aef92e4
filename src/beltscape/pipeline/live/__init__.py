"""The live system: the measurement chain from cameras to ledger records, as a program that runs without end.

`project` reads the settings, `check` tries them, `assembly` opens everything and builds the `engine` from its
`engine_components` and `measuring_parts`; `operator_controls` are what people do to it. Frame sets pass `intake`
and `measurement_run` into the `ledger`; a `writer` hands records to each sink. `gauges`, `alarm_control` with
`hidden_alarms`, `maintenance`, `production`, `zero`, `event_log` and `reporting` go on beside them, and what the
monitors of the images keep in `learned_images`.
"""

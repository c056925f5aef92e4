"""The live system: the measurement chain from cameras to ledger records, as a program that runs without end.

`project` reads the settings, `check` tries them, `assembly` opens everything and builds the `engine` from its
`engine_components` and `measuring_parts`. Frame sets pass `intake` and `measurement`; a `writer` hands records to
each sink. `monitoring`, `operation` with `controls`, `reporting` and `images` go on beside them.
"""

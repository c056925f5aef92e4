"""The steps of the measuring commands, from reconstructed frames to results with their files and reports.

One module per command: `belt`, `volume`, `lumps`, `features` (with `solids`), `zero`, `flow`. Of a moving
belt `instants` lists the frames, `flow_chain` matches and measures them, live and offline alike,
`flow_checks` compares direction and encoder with the material.
"""

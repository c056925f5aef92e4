"""The steps of the measuring commands, from reconstructed frames to results with their files and reports.

One module per command: `belt`, `volume`, `lumps`, `features` (with `solids`), `zero`; `flow` of a moving belt.
"""

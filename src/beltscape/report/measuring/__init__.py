"""Report pages of the measurements: `belt`, `volume`, `flow`, `lumps`, and `features` of the module."""

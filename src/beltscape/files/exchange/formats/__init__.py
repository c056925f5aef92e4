"""The formats of other programs, one module each; `beltscape.files.exchange` describes their common interface."""

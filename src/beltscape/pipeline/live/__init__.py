"""The live system: the measurement chain from cameras to ledger records, as a program that runs without end."""

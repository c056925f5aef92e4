"""Frame sets to ledger entries: one run, the ledger that joins runs, and the mean cross-sections."""

"""The one writer of the database: ledger, sums, recovery."""

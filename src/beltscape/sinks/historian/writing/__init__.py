"""The one writer of the database: ledger, sums, recovery.

`store` is the entrance and the only writer. `ledger` appends records with `sums` and `buckets`, `findings` and
`production` theirs. `recovery` continues after damage with what `catch_up` reads, `rescue` when another program
changed the file, `reserve` when the disk is full.
"""

"""Recordings measured again: a year of them in pieces, on one machine or a cluster, into one ledger.

In the order of the work: `recordings` finds them, `pieces` cuts them, `measuring` measures a piece on a
worker, `manifest` keeps what is done, `history` makes one ledger, `report` shows it; `run` is the entrance.
`throughput` is the speed meanwhile. `comparison` compares two ledgers.
"""

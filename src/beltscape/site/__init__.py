"""The page of a site: several belts, each measured by a machine of its own, and the balances between them.

`settings` is site.toml. `client` reads one belt's HTTP interface with a key (`answers` are its answers, `faults` what
can be wrong with it); `follower` is the thread that keeps one belt's state and fetches its ledger by record numbers,
`catch_up` decides which records count, and `store` keeps their sums on the disk. `balance` compares what enters a
transfer point with what leaves it, `balancing` does so for every closed window; `periods` are hours, shifts and days.
`app` and the folder ``page`` show it all, `run` joins the parts.
"""

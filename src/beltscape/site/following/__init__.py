"""One belt as the site follows it: `follower` is the thread that keeps its state and fetches its ledger.

`client` reads the belt's HTTP interface with a key, `answers` are its answers, `faults` what can be wrong with it;
`catch_up` decides which records count.
"""

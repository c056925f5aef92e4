"""Reading of one belt by the site: its answers, its faults, and the records that count.

`client` reads the belt's HTTP interface with a key, `answers` are its answers, `faults` what can be wrong with it;
`catch_up` decides which records count.
"""

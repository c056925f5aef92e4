"""The page of a site: several belts, each measured by a machine of its own, and the balances between them.

`settings` is site.toml. `follower` is the thread that follows a belt: `client` reads its interface,
`catch_up` decides which records count; `store` keeps the sums on the disk. `balance` compares what enters a
transfer point with what leaves it, `balancing` does so for every closed window. `app` and the folder ``page``
show it, `run` joins the parts.
"""

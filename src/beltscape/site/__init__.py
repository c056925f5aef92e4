"""The page of a site: several belts, each measured by a machine of its own, and the balances between them.

`settings` is site.toml. `follower` is the thread that follows a belt, by ``following``, and `store` keeps the sums of
its records on the disk. `balance` compares what enters a transfer point with what leaves it, `balancing` does so for
every closed window; `periods` are hours, shifts and days. `views` is what the page shows, `app` and the folder
``page`` show it, `run` joins the parts.
"""

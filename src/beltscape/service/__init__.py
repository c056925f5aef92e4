"""The service of a running plant: an observer of the run, shown on a page and through an HTTP interface.

`plant` is the entrance: it reads the `project`, joins the run with what it serves, and keeps it running (`hosting`).
`live_state` follows the run; `view_models` give what a page shows of it; `api` serves both and the history, behind
`access`. `app` joins routes and static files of the `page`. `production`, `protocols`, `backup` and `changes` are the
subjects beside measuring; `check` tries all of it without a run.
"""

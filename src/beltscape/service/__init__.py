"""The service of a running plant: an observer of the run, shown on a page and through an HTTP interface.

`plant` is the entrance: it reads the `project`, joins the run with what it serves, and keeps it running
(`hosting`, with `tls` and `data_rights`). `live_state` follows the run and `log` writes its events;
`view_models` give what a page shows of it, with the `belt_surface`; `api` serves both and the history, behind
`access`. `app` joins routes and `static` files of the folder ``page``. `settings` is the table [web].

The subjects beside measuring are `production`, `protocols` (tried by `protocol_checks`), `backup` with
`restoring` of a `backup_archive`, and `changes` of a running plant, which a `reloader` makes on
`reload_requests`; `check` tries all of it without a run.
"""

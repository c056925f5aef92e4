"""Production beside the measurement: figures, the belt scale's counter, reports and their mail.

`serving` is the entrance. `figures` compares batches, shifts and days with the belt scale, which `scale_watch` reads
by `scale_counter`. `reports` writes a report when its period is over; it waits in the `outbox` for `mail` and
`printing`, which run `commands`; `report_checks` tries their settings.
"""

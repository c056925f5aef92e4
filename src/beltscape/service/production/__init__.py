"""Production beside the measurement: figures, the belt scale, reports and their delivery.

`serving` is the entrance. `figures` compares batches, shifts and days with the belt scale, which `belt_scale`
reads. `reports` writes a report when its period is over, and checks the settings; `mail` and `printing`
deliver it.
"""

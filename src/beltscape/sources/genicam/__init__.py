"""GenICam cameras over GigE Vision, through Aravis: triggered, matched to frame sets, monitored, reopened.

`source` is the entrance; `camera` runs one camera's threads, `device` opens it by `aravis`, `pixels` decodes
its images, `clock` and `matching` assign them to instants, `adaptive_exposure` sets their exposure, `health`
assesses the camera. `settings` is the table [cameras]. For cameras that `beltscape.sources.fake_genicam`
simulates it is the same.
"""

"""GenICam cameras over GigE Vision, through Aravis: triggered, matched to frame sets, monitored, reopened.

`source` is the entrance; `camera` runs one camera's threads, `device` opens it, `clock` and `matching` assign its
images to instants, `health` assesses it. `fake` simulates cameras.
"""

"""GenICam cameras over GigE Vision, through Aravis: triggered, matched to frame sets, watched, re-opened."""

"""Flow on a moving belt: volume and mass of the passing load, strip by strip.

`meter` is the entrance, live and offline: each pushed frame gets its position on the belt by `motion_tracker` with
`motion`, `fusion` joins the frames of the same belt, `strip_cutter` cuts it, `records` sums a strip with σ.
`periodic_checks` measure the largest lump and the lateral offset.
"""

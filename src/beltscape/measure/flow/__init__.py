"""Flow on a moving belt: volume and mass of the passing load, strip by strip.

`meter` is the entrance, live and offline: each pushed frame gets its `location` on the belt by
`motion_tracker`: `registration` finds the shift of the load between two frames for the `material_observer`,
`plausibility` and `motion_evidence` decide whether it may be one, `encoder_check` compares the encoder with
it, `belt_motion` joins both to a position, `foreign_objects` are what does not travel with the belt. `fuse`
joins the frames of the same belt to `rows`, `blocks` of which have their holes filled, `strip_cutter` cuts it
into `strips`, whose load is integrated along the `profile` and weighed by `density`. `periodic_checks` measure
the largest lump and the lateral offset. `settings` are the engineer's.
"""

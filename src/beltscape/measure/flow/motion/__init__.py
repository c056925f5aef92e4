"""The motion of belt and load: where each frame is on the belt, from the material, the encoder and the last speed.

The meter gets a `pushed_frame`. `registration` finds the shift of the load between two frames, `plausibility`
decides whether it may be one.
`encoder_check`, `encoder_scale` and `readings` compare the encoder with the material and with itself;
`encoder_finding` states the result. `belt_motion` joins both to a position, `first_motion` before any is known;
`recount` corrects positions that the encoder gave wrongly. `location` holds a frame's results.
"""

"""The empty belt: its frame, cross-section, ends and edges, learned from depth maps.

`empty_belt` is the entrance: it joins the depth maps, `initial_frame` estimates the frame from blocks or from
the edges of a flat belt, `cross_section` fits direction and section and describes what differs from it,
`extent` selects the continuous surface under the optical axis and finds its ends along the core's rays,
`edges` finds the middle and locates the sides. `given` applies what the engineer gives by `settings`.
`reference` is the empty belt below a moving load.
"""

"""The empty belt: its frame, cross-section, ends and edges, learned from depth maps.

`empty_belt` is the entrance: `average` joins the depth maps, `component` selects the continuous surface under the
optical axis, `initial_frame` estimates the frame from its `blocks` or from the `flat_edges` of a flat belt,
`cross_section` fits direction and section, `extent` finds its ends along the core's rays, `middle` and `edges` find
the middle and locate the sides, `deviation` what differs from one section and how errors of neighbouring pixels
correlate. `given` applies what the engineer gives by `settings`.
"""

"""The empty belt: its frame, cross-section, ends and edges, learned from depth maps.

`empty_belt` is the entrance: `average` joins the depth maps, `initial_frame` estimates the frame from `blocks` or
from the `flat_edges` of a flat belt, `cross_section` fits direction and section, `middle` and `edges` find the middle
and the sides, `deviation` what differs from one section, `error_correlation` how errors of neighbouring pixels
correlate. `plane` fits a robust plane.
"""

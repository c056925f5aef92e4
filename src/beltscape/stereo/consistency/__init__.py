"""Camera consistency: whether the images of one frame agree with the rig, camera by camera.

`tie_points` chooses textured points of the core image; `guided` (by a depth map) or `unguided` (by rectified pairs)
finds them in the auxiliary images, each at its correlation's `peak`; `residuals` splits what is found into the
component across the epipolar line and the inverse depth along it; `trend` extracts what is systematic in either;
`allowance` is what the rig's covariance permits; `isolation` names the cameras at fault; `motion` fits the movement
of one camera; `exchange` finds two that changed places; `check` is all of it; `texts` are its lines, `sparse` those
of a frame that is measured in few places.
"""

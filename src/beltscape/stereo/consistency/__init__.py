"""Camera consistency check: whether the images of one frame agree with the rig, camera by camera.

`check` runs these stages:

1. `tie_points` detects textured points in the core image.
2. `guided_matching` (with a depth map) or `unguided_matching` (in rectified pairs) finds them in the auxiliaries.
3. `residuals` computes the epipolar residual and the inverse depth of each match.
4. `systematic_residual` estimates what the residuals of an image have in common.
5. `tolerance` computes the systematic residuals that the rig's covariance permits.
6. `faults` finds the cameras whose residuals exceed the tolerance, and the movement of one camera that explains them.

`accumulation` joins the tie points of several frames. `diagnosis` finds cameras whose images were exchanged or
mirrored, describes the faults in one line each, and says why few pixels of a frame are measured.
"""

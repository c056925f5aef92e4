"""Camera consistency check: whether the images of one frame agree with the rig, camera by camera.

`check` runs these stages:

1. `tie_points` detects textured points in the core image.
2. `guided_matching` (with a depth map) and `unguided_matching` (in rectified pairs) find them in the auxiliaries.
3. `residuals` computes the epipolar residual and the inverse depth of each match.
4. `systematic_residual` estimates what the residuals of an image have in common, `row_fit` the row error as a
   function of place. The matching with which more points agree is assessed.
5. `tolerance` computes the systematic residuals that the rig's covariance permits.
6. `faults` finds the cameras whose residuals exceed the tolerance, and the movement of one camera that explains them.
7. `undecided` finds those in which more textured points fail than agree.

`accumulation` joins the tie points of several frames. `diagnosis` finds cameras whose images were exchanged, mirrored
or taken at another instant, and the quantity of the rig that is wrong; it describes the faults in one line each, and
says why few pixels of a frame are measured.
"""

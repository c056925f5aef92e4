"""Camera consistency check: whether the images of one frame agree with the rig, camera by camera.

`check` runs these stages:

1. `tie_points` detects textured points in the core image and finds them in the auxiliaries by the peaks of
   `correlation`: guided by a depth map, and unguided in rectified pairs.
2. `residuals` computes the epipolar residual and the inverse depth of each match, and what the residuals of
   an image have in common; `rig_consistency` fits the row error as a function of place. The matching with
   which more points agree is assessed.
3. `tolerance` computes the systematic residuals that the rig's covariance permits.
4. `isolation` finds the cameras whose residuals exceed the tolerance, `pose_change` the movement that
   explains them.
5. Cameras in which more textured points fail than agree remain undecided.

The check also joins the tie points of several frames. `diagnosis` describes the faults in one line each and
says why few pixels of a frame are measured; `wrong_images` finds cameras whose images were exchanged,
mirrored or taken at another instant, `wrong_quantity` the quantity of the rig that is wrong.
"""

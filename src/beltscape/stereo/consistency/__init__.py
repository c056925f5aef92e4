"""Camera consistency check: whether the images of one frame agree with the rig, camera by camera.

`check` runs these stages:

1. `tie_points` detects textured points in the core image.
2. `guided_matching` (with a depth map) or `unguided_matching` (in rectified pairs) finds them in the auxiliaries.
3. `residuals` computes the epipolar residual and the inverse depth of each match.
4. `systematic_residual` estimates what the residuals of an image have in common.
5. `tolerance` computes the systematic residuals that the rig's covariance permits.
6. `fault_isolation` finds the cameras whose residuals exceed the tolerance.
7. `pose_change` fits the movement of one camera that explains the residuals.

`exchange` finds two cameras whose images were exchanged. `fault_texts` describes the faults in one line each.
`low_coverage` diagnoses why few pixels of a frame are measured.
"""

"""Images of a board to a calibrated rig.

The stages in order: `detection` (board corners in images), `intrinsics` (one camera, Zhang), `network`
(camera pairs, association, global optimisation: the paper's Section 2.2), `hierarchy` (these as one
function), `bundle_adjustment` (the final rig), `assessment` (scores, covariance, next views) and `result`
(all of it in one object). `solver` holds the numerical parts of all of them.
"""

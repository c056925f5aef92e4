"""Checks of heights against the learned empty belt.

`cells` reduces a depth map to the robust heights of small cells over the learned belt. `zero_shift` finds the
bare belt among them and estimates its rigid motion since it was learned; `zero_finding` judges it, in one
frame and averaged over frames. `zero_setting` moves the learned belt by it, on the operator's request.
`residue` is the material stuck to the belt, carry-back and spillage. `passes` follows the belt over its
revolutions, with its `splices` and `torn_edges`; `monitor` carries these checks over frames.
"""

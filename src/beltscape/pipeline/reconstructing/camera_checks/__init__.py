"""Checks of the cameras while frames are matched: whether they still are where the rig says.

`schedule` decides which frames are checked, `check` does so, `findings` states the result, `systematic_error` adds
its effect to σ, `rig_proposal` offers the rig in which a moved camera stands where it was found; `faults` warns of
what a measured frame was reconstructed with.
"""

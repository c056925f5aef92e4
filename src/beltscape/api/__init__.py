"""The Python interface: verbs that take and return arrays, loaded by ``import beltscape as bs``.

`files` reads and writes, `calibration` makes a rig, `reconstruction` turns images into depth, `measuring`
turns depth into quantities of one frame, `flow` measures a moving belt. The functions check their arguments,
name the one that does not fit, and call the same stages as the commands do; nothing is printed unless a
reporter is given.
"""

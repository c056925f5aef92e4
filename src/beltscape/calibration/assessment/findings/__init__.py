"""Findings of a calibrated rig in words: faults, what the joint adjustment refutes, left-out views, the verdict."""

"""Measurement of the material flow, offline and live.

`capture` is the entrance of `measure flow`: `instants` lists its frames, `chain` matches and measures them as the
live system does, `checks` compares direction and encoder with the material, `files` writes the result. `same_rig`
refuses an empty belt of another rig; `density` reads what the material weighs.
"""

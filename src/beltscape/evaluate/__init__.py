"""Evaluation against ground truth: scores, simulated truth, the paper's experiments and the demo.

`truth` reads what a simulated scene is. `depth_scores`, `frame_scores` and `lump_scores` compare results with
it. `structured_light` and `line_laser` are simulated sensors to compare with; `paper` repeats the paper's
experiments. `demo` runs the whole chain on the shipped capture.
"""

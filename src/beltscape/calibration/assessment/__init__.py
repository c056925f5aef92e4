"""Assessment of a rig: what it is worth, and which views it lacks.

`covariance`, `coverage` and `lens_domain`, `score` and `fit_quality` are its figures; `diagnosis` joins them.
`cross_validation` scores rigs on frames that they were not fitted to; `findings` and `verdict` say in words
what the figures mean; `next_best_view` says where the board is to be held next.
"""

"""The paper's method: every auxiliary forms a rectified pair with the core; the pairs' depths are averaged.

`reconstructor` is the entrance: `rectification` brings a pair to common rows, `sgbm` matches it.
"""

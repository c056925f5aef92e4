"""Projected markers of the speckle pattern (the paper's Section 2.1): detection, numbering, regions.

`detection` finds them in one image, `lattice` the rows and columns among them, `grid` numbers them.
"""

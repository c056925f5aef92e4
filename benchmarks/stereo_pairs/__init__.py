"""Real stereo pairs with reference measurements, and scores against them.

`read_pairs` reads them: a `disparity_pair` has dense true disparity, a `speckle_pair` point correspondences.
`subsets` are found in a second image by digital image correlation.
"""

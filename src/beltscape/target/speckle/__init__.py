"""The projector's speckle pattern: its generation, images, description and quality.

`pattern` is the entrance: `darts` throws dots up to the share of `packing`, `blue_noise` measures how even they are.
`disc_coverage` and `pattern_image` draw it pixel by pixel, `pattern_svg` as curves, `pattern_json` keeps every dot.
"""

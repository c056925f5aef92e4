"""Measuring in depth maps: the empty belt, volume, flow, lumps, and the features of a calibration module.

`belt` determines the belt frame and the empty belt; `surface` makes height maps in it, of reliable pixels;
`holes` fills their occlusion holes; `volume` and `flow` measure loads, `lumps` their top layer, and
`features` a calibration module.

Constants that name no source have no recorded experiment; docs/reference/constants.md shows what halving and
doubling each of them changes.
"""

"""Calibration targets and the projector's pattern.

`board` reads a calibration board (`planar_boards`, several in a `board_set`), `module` a calibration module;
`print_board` makes a `sheet` of a board. `pattern` throws the dots of the projector's pattern,
`pattern_formats` writes it, `blue_noise` measures how even it is.
"""

"""Readings of an encoder that arrive as lines of text, turned into positions of the belt over time.

`text` parses a line, `count` converts counts to millimetres, `device_clock` brings another machine's times to this
one's, `track` interpolates; `stream` joins them.
"""

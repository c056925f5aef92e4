"""The encoder of the belt: position by frame or time, from a file, datagrams, a table or a constant speed.

`opening` is the entrance, and has the encoders that need no device. `tail` follows a file, `udp` receives
datagrams; `readings` turns their lines into counts, with the offset of the counter, and `track` these into
positions over time. `settings` describe the encoder.
"""

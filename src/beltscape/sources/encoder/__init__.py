"""The encoder of the belt: its position by frame or time, from a file, datagrams, a table or a constant speed.

`opening` is the entrance. `tail` follows a file (`file_tail`), `udp` receives datagrams; `readings` turns their lines
into positions, with the `offset` of the counter. `simple` encoders need no device.
"""

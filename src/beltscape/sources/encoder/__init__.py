"""The belt's encoder: its position by frame or time, from a file, datagrams, a table or a constant speed."""

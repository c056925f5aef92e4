"""A service as a process: its web server, its start and end under systemd, the rights of its data folder.

The plant's service and the page of several plants share it.
"""

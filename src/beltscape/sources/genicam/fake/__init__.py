"""GigE Vision cameras that are not there: Aravis's simulated ones, showing pictures of a capture.

They speak the real protocol over the loopback interface, each in a process of its own that can be killed and
started again: for tests, and for trying out a running system without cameras.
"""

"""Simulated GigE Vision cameras (Aravis's) that send the images of a capture.

They use the real protocol over the loopback interface, each in a process of its own that can be killed and
started again: for tests, and for trying a running system without cameras. `camera` is one of them,
`simulated_cameras` are those of a capture; ``python -m beltscape.sources.fake_genicam CAPTURE`` runs them.
"""

"""Reports of belt, volume, flow, lumps and module."""

"""Measuring commands: reconstructed frames to volumes, flow, lumps and dimensions."""

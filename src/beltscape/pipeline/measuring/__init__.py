"""The steps of the measuring commands, from reconstructed frames to volume, flow, lumps and dimensions."""

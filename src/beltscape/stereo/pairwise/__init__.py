"""The paper's way: every auxiliary with the core as a rectified pair, their depths fused."""

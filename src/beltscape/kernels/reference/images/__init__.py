"""Images and fields: splines, warps, values about given pixels, and statistics of windows (reference)."""

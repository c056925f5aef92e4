"""Registration of the load between two frames: its high-pass heights, and the shift between two of them."""

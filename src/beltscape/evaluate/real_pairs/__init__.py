"""Real stereo pairs with reference measurements, and scores against them."""

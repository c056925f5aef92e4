"""Real stereo pairs with references."""

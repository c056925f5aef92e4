"""Selection among candidate surfaces for uncertain pixels, by photo-consistency and context features."""

"""The projected markers: found, told apart, and what they say of the depths between them."""

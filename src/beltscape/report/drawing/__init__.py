"""Charts, pictures, colours and 3-D scenes that reports are made of."""

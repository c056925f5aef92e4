"""Small networks, and message passing between pixels."""

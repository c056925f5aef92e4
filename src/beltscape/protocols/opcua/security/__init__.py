"""Access to the server: certificates of clients, sessions of users, and bounds of a connection."""

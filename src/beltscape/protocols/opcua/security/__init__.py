"""Who enters: certificates of clients, sessions of users, and bounds of a connection."""

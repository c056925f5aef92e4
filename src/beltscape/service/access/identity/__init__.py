"""Users: roles, passwords, accounts, sessions and keys of programs."""

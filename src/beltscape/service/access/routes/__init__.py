"""The routes and pages of access: set-up, login, accounts, users."""

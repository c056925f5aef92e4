"""Requests: checked, authorised and audited before any route handles them."""

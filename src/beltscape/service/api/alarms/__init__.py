"""Alarms: their routes, the models of the answers, and the journal as CSV."""

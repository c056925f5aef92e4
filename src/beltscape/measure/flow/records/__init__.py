"""Strips of belt as flow records and totals with their standard deviation."""

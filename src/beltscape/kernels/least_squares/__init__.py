"""Least squares of inverse depth: normal equations of all views, and local planes."""

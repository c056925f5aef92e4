"""Destinations of finished records and raw frames: the historian's database, CSV tables, recordings."""

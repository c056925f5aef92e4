"""Backups of a plant, made while it runs, and their restoring: history, users, settings, rig, belt, certificates."""

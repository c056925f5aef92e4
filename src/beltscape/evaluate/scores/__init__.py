"""Scores of depth maps, rigs and lumps against the truth."""

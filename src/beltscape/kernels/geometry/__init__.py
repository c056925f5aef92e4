"""Geometry: triangulation, visibility, ray march and rasterised heights."""

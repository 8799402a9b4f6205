"""Renders the captures of a scene and its ground truth."""

Place = tuple[float, float, float]
"""x, y, z, metres."""

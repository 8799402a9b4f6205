"""Renders a scene as cameras see it, and what is true in it."""

Place = tuple[float, float, float]
"""x, y, z, metres."""

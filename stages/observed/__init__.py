"""Poses of cameras from observations of things that move before them, or that have an identity of their own."""

"""Depth of one view, refined against all views around it."""

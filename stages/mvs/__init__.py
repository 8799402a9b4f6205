"""Depth of one view judged by all views around it."""

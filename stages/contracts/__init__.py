"""What the engine and the vision share: plain dataclasses, names and defaults.

This is the only part of the vision that the engine imports.  It needs Python's standard library alone, so that the engine starts
without numpy or OpenCV.  What one half writes and the other reads is declared here once: a field that is renamed on one side only
is an error of mypy.
"""

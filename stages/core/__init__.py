"""Functions that several packages share: camera geometry, lenses, compiled loops, nearest points, sorting."""

"""What several rooms share: compiled loops, nearest points, sorting."""

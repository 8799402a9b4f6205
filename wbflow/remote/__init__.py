"""Work folders and captures in an object store."""

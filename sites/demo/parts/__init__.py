"""Static and moving parts of scenes."""

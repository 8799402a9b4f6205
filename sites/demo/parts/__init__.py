"""What stands and moves in scenes."""

"""What a night leaves for people and programs."""

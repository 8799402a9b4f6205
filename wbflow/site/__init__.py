"""Site files: read, validated, and their errors explained."""

"""What a site file says: read, validated, explained."""

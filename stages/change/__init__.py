"""What changed between two nights of the same fixed cameras: distances, free space, likeness of photographs, clusters."""

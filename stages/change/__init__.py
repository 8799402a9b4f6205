"""Changes between two nights of the same fixed cameras: cloud distances, free space, image correlation, clusters."""

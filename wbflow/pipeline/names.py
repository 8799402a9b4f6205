"""Names of the stages that the engine knows for more than handing on their results."""

FRAMES, HEALTH, PAIRS, MATCHES, GEOMETRY = "frames", "health", "pairs", "matches", "geometry"
POSES, DENSE_PAIRS, RECTIFY, DISPARITY = "poses", "dense_pairs", "rectify", "disparity"
DEPTH, REFINE, FUSE, CHANGES = "depth", "refine", "fuse", "changes"

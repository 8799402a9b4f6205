"""Results in the forms that people and other programs look at: pictures, files of a pair, LAZ, meshes, COLMAP, maps."""

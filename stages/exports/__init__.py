"""Export of results for people and other programs: previews, files of a pair, LAZ, meshes, COLMAP, maps."""

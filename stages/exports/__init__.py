"""A site's results in the forms that other programs read: LAZ, meshes, COLMAP models, height and depth maps."""

"""Structure from motion: from two-view geometries to one consistent set of cameras.

tracks -> rotations -> mapping (triangulation, bundle), in the order in which `poses` uses them.  Cameras are numbered by their
position in a list of views; which ids they have is known to `poses` only.
"""

"""Structure from motion: from two-view geometries to one consistent set of cameras.

In the order of use: `focal` (lenses), `rotation_averaging`, `tracks`, `incremental` (with `triangulation` and `bundle`), `world`;
`problem` and `solve` put them together.  Inside, cameras are numbered by their position in the site; only `problem` and `solve`
know ids.
"""

"""Structure from motion: from two-view geometries to one consistent set of cameras.

In the order of use: `focal` (lenses), `loops` and `rotation_averaging` (which pairs are believed), `tracks`, `incremental` (with
`triangulation` and `bundle`), `world`; `view_graph` and `solve` put them together.
`pose_check` compares known poses with the images.  Inside, cameras are numbered by their position in the site; only `loops`,
`pose_check`, `view_graph`, `world` and `solve` know ids.
"""

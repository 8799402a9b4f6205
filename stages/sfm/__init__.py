"""Structure from motion: from two-view geometries to models, each in a frame of its own.

In the order of use: `loops` and `rotation_averaging` (which pairs are believed), `tracks`, `incremental` (with `triangulation`
and `bundle`); `view_graph` puts them together, and `rigs` holds together the views of one wide camera.  Inside, cameras are
numbered by their position in the site; only `loops` and `view_graph` know ids.
"""

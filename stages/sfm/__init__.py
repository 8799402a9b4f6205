"""Structure from motion: from two-view geometries to models, each in a frame of its own.

Order of use: `loops` and `rotation_averaging` (select pairs), `tracks`, `incremental` (with `triangulation` and `bundle`);
`view_graph` combines them, and `rigs` keeps the views of one wide camera together.  Internally, cameras are numbered by their
position in the site; only `loops` and `view_graph` use ids.
"""

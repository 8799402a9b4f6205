"""`wbflow edit`: masks, privacy polygons, zones and control points, drawn on captures in a page of this machine."""

"""`wbflow edit`: draw masks, privacy polygons, zones and control points on captures, in a local web page."""

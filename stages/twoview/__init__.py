"""Two-view geometry: F and E, estimated, refined and judged."""

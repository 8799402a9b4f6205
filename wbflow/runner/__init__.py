"""One run, from its plan to its published folder; `life` is where to begin."""

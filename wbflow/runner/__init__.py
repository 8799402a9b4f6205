"""One run: its context, its plan, and how that is done."""

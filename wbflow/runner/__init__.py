"""One night: its captures, its plan, and how it is done."""

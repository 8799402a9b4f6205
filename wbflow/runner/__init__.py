"""One run: its context, its plan, and the execution of the plan."""

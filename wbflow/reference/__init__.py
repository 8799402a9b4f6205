"""The reference: the run that later nights are compared with, and what they reuse of it."""

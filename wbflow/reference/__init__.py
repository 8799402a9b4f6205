"""The reference: which run later nights are compared with, and what they take from it."""

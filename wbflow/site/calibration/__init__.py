"""Calibrations in the forms in which programs write them."""

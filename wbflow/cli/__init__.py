"""The commands, one file for each purpose.  They import what they need when they need it."""

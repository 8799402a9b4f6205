"""Files of the work folder: how they are written, checked, found again and cleaned up."""

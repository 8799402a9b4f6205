"""Files of one thing each: EXIF and JPEG, rasters; cameras and clouds as plain data."""

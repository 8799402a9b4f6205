"""File formats as data: EXIF and JPEG headers, rasters, scans; cameras and clouds as plain data."""

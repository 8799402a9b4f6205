"""Pictures in and out: EXIF, rasters, previews."""

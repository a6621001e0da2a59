"""Image files: names, folders, decoding, EXIF orientation and size."""

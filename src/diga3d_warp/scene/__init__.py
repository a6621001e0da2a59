"""Captures: cameras, views and masks, and `load.load_scene`, which reads a capture of any layout."""

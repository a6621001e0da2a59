"""Captures: cameras, views, masks, and the readers that recognise a folder by itself."""

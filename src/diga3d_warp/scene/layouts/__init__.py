"""Layouts of captures: recognition of a folder, and one reader for each layout."""

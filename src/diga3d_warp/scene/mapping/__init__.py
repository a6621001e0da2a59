"""Poses and sparse points from photographs, with pycolmap."""

"""Checks of a capture: calibration, and whether cameras, points and photographs agree."""

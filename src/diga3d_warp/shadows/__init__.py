"""The shadow and the mirror image of an object on the surface that it stands on: found, and taken back."""

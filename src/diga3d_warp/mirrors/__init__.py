"""The mirror image of an object in the surface that it stands on."""

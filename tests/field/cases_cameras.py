"""Cases of camera files: lens, poses, sizes, text."""

"""Cases of frames, scales and offsets."""

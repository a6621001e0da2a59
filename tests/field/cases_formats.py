"""Cases of splat and point cloud files."""

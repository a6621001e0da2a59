"""Scaffold-GS (Lu et al. 2024): anchors on a voxel grid, decoded to gaussians for each camera."""

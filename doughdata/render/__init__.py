"""Depth images of meshes, tools and table."""

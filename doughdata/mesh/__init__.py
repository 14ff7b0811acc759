"""Closed meshes and label grids of components."""

"""Shapes that bodies are made of; a new one is one file here or an entry point elsewhere."""

from doughdata.scenes.shapes.base import shape_of

__all__ = ["shape_of"]

"""Hypothesis strategies for records, shipped for plug-in authors (needs `hypothesis`)."""

from doughdata.testing.strategies import actions, bodies, materials, scenes, tools

__all__ = ["actions", "bodies", "materials", "scenes", "tools"]

"""Hypothesis strategies for records, shipped for plug-in authors."""

"""Exporters: a dataset's scenes in formats that other programs open."""

"""Recordings become scenes of a dataset: a robot's MCAP and bag files, clouds, other datasets."""

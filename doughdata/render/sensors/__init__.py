"""Sensors: from an ideal depth image to what a real camera reports."""

"""Marker and target geometry, lights, transport rendering, EXR in and out."""

"""Marker, target and view; what shows where in the image; transport rendering; files in and out."""

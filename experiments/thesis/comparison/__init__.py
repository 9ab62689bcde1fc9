"""Encoding markers and plain ones beside the Mantis Marker: attitude error over tilt at equal pixel size (thesis section 5.1)."""

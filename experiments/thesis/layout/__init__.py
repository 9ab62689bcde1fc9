"""Several markers on a spacecraft face: placement, footprint, what is in view, and one pose from all (thesis section 6.1)."""

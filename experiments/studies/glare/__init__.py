"""Detection and pose over the Sun's direction, mode by mode."""

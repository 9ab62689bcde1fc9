"""Transport rendering: rays, their densities, and the basis they give."""

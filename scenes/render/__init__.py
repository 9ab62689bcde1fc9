"""Transport rendering: rays, their densities, and the basis they give."""

__all__ = [
    "batch",
    "carriers",
    "density",
    "earth",
    "image",
    "lanes",
    "lattice",
    "marker_rays",
    "scene",
    "stock",
    "tracer",
    "transport",
]

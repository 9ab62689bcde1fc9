"""The sensor: charge, noise and digital numbers, and what their noise is in an image."""

__all__ = [
    "defects",
    "emva1288",
    "noise",
    "pair",
    "sensor",
]

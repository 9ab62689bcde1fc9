"""Where the parts of the marker show in the image, in closed form. Nothing here renders."""

__all__ = [
    "bits",
    "frame_light",
    "regions",
    "visible",
]

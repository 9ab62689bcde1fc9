"""Files in and out: transport EXR, the cache of bases, stock Mitsuba scenes, the printable marker."""

__all__ = [
    "cache",
    "export",
    "exr",
    "marker_files",
]

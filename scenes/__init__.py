"""Marker, target and view; what shows where in the image; transport rendering; files in and out."""

__all__ = [
    "atomic",
    "chessboard",
    "face",
    "files",
    "llvm",
    "marker",
    "projection",
    "render",
    "tags",
    "target",
    "view",
]

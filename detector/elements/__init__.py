"""The encoding elements: where their blobs are, by a model of slits, tape and LED ring."""

__all__ = [
    "blob_fit",
    "blobs",
    "slits",
]

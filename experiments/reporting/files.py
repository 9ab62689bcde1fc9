"""Result files, each written whole or not at all: NetCDF, 16-bit PNG, text; and images read from anywhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from scenes.atomic import atomic_write

if TYPE_CHECKING:
    import xarray as xr


def write_netcdf(dataset: xr.Dataset | xr.DataTree, path: Path | str) -> None:
    """Write a labelled dataset as NetCDF-4, compressed, or a tree of them.

    A dataset is made in memory: HDF5 does not survive a disk that fills while it writes.
    """
    from xarray import DataTree

    if isinstance(dataset, DataTree):
        with atomic_write(path) as temporary:
            dataset.to_netcdf(temporary, engine="h5netcdf")
        return
    encoding = {name: {"zlib": True, "complevel": 4} for name, v in dataset.data_vars.items() if v.dtype.kind in "fiub"}
    content = dataset.to_netcdf(engine="h5netcdf", encoding=encoding)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def write_png(image: NDArray[np.uint16] | NDArray[np.uint8], path: Path | str) -> None:
    """Write digital numbers, as they are, to a greyscale PNG of their own depth."""
    with atomic_write(path) as temporary:
        if not cv2.imwrite(str(temporary), image):
            raise OSError(f"{path}: cannot be written")


def write_text(text: str, path: Path | str) -> None:
    """Write text as UTF-8."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _decode(data: bytes) -> NDArray[Any] | None:
    """Greyscale image of a file's bytes, None where OpenCV cannot read it; its own chatter on standard error is silenced."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)


def read_image(path: Path | str) -> NDArray[Any]:
    """A greyscale image as it is stored, 8 or 16 bits, or the first channel of an EXR; colour becomes luminance.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no image, or holds NaN or infinity.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    if path.suffix.lower() == ".exr":
        from scenes.files.exr import read_channels

        image: NDArray[Any] | None = next(iter(read_channels(path)[0].values()), None)
    else:
        image = _decode(path.read_bytes())
    if image is None or image.ndim != 2:
        raise ValueError(f"{path}: not an image that can be read; expected PNG, TIFF, PGM, JPEG or EXR")
    if not np.all(np.isfinite(image)):
        raise ValueError(f"{path}: holds NaN or infinite pixels; expected finite numbers")
    return image

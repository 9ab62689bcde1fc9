"""Transport bases and electron images as OpenEXR files with named float32 layers and typed attributes.

A layer is one channel, ``<light>.nm<wavelength>``, for example ``led.nm0850``. A sample of the renderer's error is
``<light>.noise``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.atomic import atomic_write
from scenes.view import UNITS, TransportBasis

_LAYER = re.compile(r"(led|sun|earth)\.nm(\d{4})\Z")
_NOISE = ".noise"
_PREFIX = "mantis_"


def write_basis(basis: TransportBasis, path: Path | str) -> None:
    """Write every layer, its unit, and the attributes of the basis (their names prefixed with ``mantis_``).

    Args:
        basis: of any view.
        path: of the EXR file.

    Raises:
        OSError: when the file cannot be written.
    """
    channels = {
        f"{light}.nm{node:04d}": np.ascontiguousarray(images[k])
        for light, images in basis.layers.items()
        for k, node in enumerate(basis.nodes_nm)
    }
    channels |= {light + _NOISE: np.ascontiguousarray(image) for light, image in basis.noise.items()}
    units = {f"unit_{light}": UNITS[light] for light in basis.layers}
    write_channels(channels, {**units, **basis.attributes}, path)


def read_basis(path: Path | str) -> TransportBasis:
    """Read a transport basis.

    Args:
        path: of the EXR file.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no EXR file, or its layers are not those of a transport basis.
    """
    channels, attributes = read_channels(path)
    found: dict[str, dict[int, NDArray[np.float32]]] = {}
    for name, image in channels.items():
        match = _LAYER.match(name)
        if match:
            found.setdefault(match[1], {})[int(match[2])] = image
    if set(found) - {"earth"} != {"led", "sun"}:
        raise ValueError(
            f"{path}: layers {', '.join(sorted(channels)) or 'none'}; expected led.nmNNNN and sun.nmNNNN, "
            "as `mantis render` writes them"
        )
    nodes = tuple(sorted(found["led"]))
    for light in found:
        if tuple(sorted(found[light])) != nodes:
            raise ValueError(f"{path}: the led and {light} layers have different wavelengths")
    layers = {light: np.stack([images[node] for node in nodes]) for light, images in found.items()}
    for light, images in layers.items():
        if not np.all(np.isfinite(images)) or np.any(images < 0):
            raise ValueError(f"{path}: layer {light} holds NaN, infinite or negative radiance [{UNITS[light]}]")
    for light in layers:
        attributes.pop(f"unit_{light}", None)
    noise = {light: channels[light + _NOISE] for light in layers if light + _NOISE in channels}
    return TransportBasis(nodes, layers, attributes, noise)


def write_channels(
    channels: dict[str, NDArray[np.float32]], attributes: dict[str, str | float], path: Path | str
) -> None:
    """Write float32 channels and attributes to a ZIP-compressed EXR, whole or not at all.

    Args:
        channels: images (height, width) by name.
        attributes: by name, without prefix.
        path: of the EXR file.

    Raises:
        OSError: when the file cannot be written.
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header.update({_PREFIX + key: value for key, value in attributes.items()})
    with atomic_write(path) as temporary, OpenEXR.File(header, channels) as file:
        try:
            file.write(str(temporary))
        except RuntimeError as error:  # all that the binding says of a full disk
            raise OSError(f"{path}: cannot be written ({error})") from error


@contextmanager
def _silence() -> Iterator[None]:
    """Swallow what the library prints about damaged files, on both streams, before it raises an exception about them."""
    with Path(os.devnull).open("w") as sink, redirect_stdout(sink):
        kept = os.dup(2)
        os.dup2(sink.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def read_channels(path: Path | str) -> tuple[dict[str, NDArray[np.float32]], dict[str, str | float]]:
    """Read all channels as float32, and this project's attributes without their prefix.

    Args:
        path: of the EXR file.

    Returns:
        Images (height, width) by name, and attributes by name.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no EXR file that can be read.
    """
    import OpenEXR

    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        with _silence(), OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())  # a copy: the binding empties its own on closing
            channels = {name: np.array(channel.pixels, dtype=np.float32) for name, channel in file.channels().items()}
    except Exception as error:  # the binding raises bare RuntimeErrors and ValueErrors of many texts
        raise ValueError(f"{path}: not a readable OpenEXR file ({error})") from error
    attributes = {key.removeprefix(_PREFIX): value for key, value in header.items() if key.startswith(_PREFIX)}
    return channels, attributes

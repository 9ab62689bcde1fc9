"""Rendered transport, kept on disk by content, so that nothing is rendered twice.

The key hashes everything that changes transport: the view, the quality, the source code that renders, and the version of
the renderer. Files appear whole or not at all, so any number of processes may share a cache. Each file carries a checksum;
a truncated or foreign file is noticed and rendered again. The least recently used files make room for new ones.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from itertools import islice
from pathlib import Path

from materials import library
from scenes.files.exr import read_basis, write_basis
from scenes.render.batch import render_cases
from scenes.view import AFTER_TRANSPORT, Quality, TransportBasis, View

DEFAULT_LIMIT_BYTES = 4 * 2**30
#: A file that has been unfinished for so long has lost its writer [s].
_ABANDONED_S = 3600.0
#: Views that are looked up and rendered at a time: enough to fill the renderer, few enough for memory.
_TOGETHER = 16

#: Source files whose change makes every cached basis stale.
_CODE = {
    "scenes": ("marker.py", "target.py", "view.py", "projection/regions.py"),
    "scenes/render": (
        "batch.py",
        "carriers.py",
        "density.py",
        "earth.py",
        "image.py",
        "lanes.py",
        "lattice.py",
        "marker_rays.py",
        "scene.py",
        "stock.py",
        "tracer.py",
    ),
    "materials": ("brdf.py", "datafile.py", "library.py", "plugins.py"),
    "radiometry": ("geometry.py", "distortion.py", "optics.py", "parameters.py", "sources.py", "spectrum.py"),
}


def default_folder() -> Path:
    """The cache folder: MANTIS_CACHE, else ``mantis/transport`` in the user's cache folder."""
    if chosen := os.environ.get("MANTIS_CACHE"):
        return Path(chosen)
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "mantis" / "transport"


@cache
def code_version() -> str:
    """Hash of the source code that renders transport and of the renderer's version, 64 hexadecimal digits."""
    digest = hashlib.sha256(f"mitsuba {version('mitsuba')}".encode())
    for folder, names in _CODE.items():
        package, *inside = folder.split("/")
        for name in names:
            digest.update(files(package).joinpath(*inside, name).read_bytes())
    for entry in sorted((files("materials") / "data").iterdir(), key=lambda e: e.name):
        digest.update(entry.name.encode() + entry.read_bytes())
    return digest.hexdigest()


def key(view: View, quality: Quality, variant: str) -> str:
    """Name of a view's basis in the cache, 32 hexadecimal digits.

    Only what changes transport enters. Of the camera, F-number, transmission and stray light are left out, of the LEDs
    their power.

    Args:
        view: what is rendered.
        quality: how densely.
        variant: Mitsuba's variant.
    """
    parts = {
        "code": code_version(),
        "variant": variant,
        "quality": quality.__dict__,
        "camera": view.camera.model_dump(mode="json", exclude=set(AFTER_TRANSPORT)),
        "leds": view.leds.model_dump(mode="json", include={"count", "ring_radius_m", "half_angle_deg"}),
        **{name: getattr(view, name).model_dump(mode="json") for name in ("marker", "target", "sun")},
        "earth": view.earth and view.earth.model_dump(mode="json", exclude={"albedo"}),
        "range_m": view.range_m,
        "nodes_nm": view.nodes_nm,
        "own_materials": [library.fingerprint(name) for name in view.target.materials if library.is_path(name)],
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]


@dataclass
class TransportCache:
    """A folder of rendered bases.

    Attributes:
        folder: where the files are; it is made when first needed.
        limit_bytes: size above which the least recently used files are removed [bytes].
        rendered: how many bases this object had to render.
        reused: how many bases this object found.
    """

    folder: Path
    limit_bytes: int = DEFAULT_LIMIT_BYTES
    rendered: int = 0
    reused: int = 0

    def basis(self, view: View, quality: Quality) -> TransportBasis:
        """The basis of a view: read from the cache where its file is whole, else rendered and kept.

        Args:
            view: what to render.
            quality: how densely.

        Raises:
            RuntimeError: when it must be rendered and no Mitsuba variant can run here.
        """
        return next(self.bases([(view, quality)]))

    def bases(self, cases: Iterable[tuple[View, Quality]]) -> Iterator[TransportBasis]:
        """Bases of many views, in order. What the cache lacks is rendered together, `_TOGETHER` views at a time.

        Args:
            cases: views with their qualities, taken as they are needed.

        Raises:
            RuntimeError: when something must be rendered and no Mitsuba variant can run here.
        """
        from scenes.llvm import select_variant

        variant, rest = select_variant(), iter(cases)
        while group := list(islice(rest, _TOGETHER)):
            paths = [self.folder / f"{key(*case, variant)}.exr" for case in group]
            at_hand = {path: self._read(path) for path in dict.fromkeys(paths)}
            missing = {path: case for path, case in zip(paths, group, strict=True) if at_hand[path] is None}
            rendered = render_cases(missing.values())
            for path in paths:
                basis = at_hand[path]
                if basis is None:
                    basis = at_hand[path] = self._kept(next(rendered), path)
                else:
                    self.reused += 1
                yield basis

    def _kept(self, basis: TransportBasis, path: Path) -> TransportBasis:
        self.rendered += 1
        kept = replace(basis, attributes={**basis.attributes, "checksum": checksum(basis)})
        with suppress(OSError):  # a full or read-only disk costs a later rendering, not this result
            write_basis(kept, path)
            self._make_room(path)
        return basis

    def entries(self) -> list[tuple[Path, int]]:
        """Files of the cache and their sizes [bytes], least recently used first."""
        found = []
        for path in self.folder.glob("*.exr") if self.folder.is_dir() else ():
            try:
                status = path.stat()
            except FileNotFoundError:  # another process made room
                continue
            if not path.name.startswith("."):
                found.append((status.st_mtime_ns, path, status.st_size))
        return [(path, size) for _, path, size in sorted(found)]

    def clear(self) -> int:
        """Remove every basis, and what interrupted writers have left behind; returns how many bases there were."""
        paths = [path for path, _ in self.entries()]
        for path in paths + self._unfinished(0.0):
            path.unlink(missing_ok=True)
        return len(paths)

    def _read(self, path: Path) -> TransportBasis | None:
        try:
            basis = read_basis(path)
        except FileNotFoundError:
            return None
        except (ValueError, OSError):
            path.unlink(missing_ok=True)
            return None
        stated = basis.attributes.pop("checksum", None)
        if stated != checksum(basis):
            path.unlink(missing_ok=True)
            return None
        with suppress(OSError):
            os.utime(path)
        return basis

    def _unfinished(self, age_s: float) -> list[Path]:
        """What writers that were killed have left behind, at least so old [s]."""
        found = []
        for path in self.folder.glob(".*.exr") if self.folder.is_dir() else ():
            with suppress(FileNotFoundError):  # its writer has just finished
                if time.time() - path.stat().st_mtime >= age_s:
                    found.append(path)
        return found

    def _make_room(self, newest: Path) -> None:
        for path in self._unfinished(_ABANDONED_S):
            path.unlink(missing_ok=True)
        entries = self.entries()
        total = sum(size for _, size in entries)
        for path, size in entries:
            if total <= self.limit_bytes:
                return
            if path != newest:
                path.unlink(missing_ok=True)
                total -= size


def checksum(basis: TransportBasis) -> str:
    """SHA-256 of the wavelengths and of the bytes of every layer and its noise, 64 hexadecimal digits.

    Args:
        basis: of any view.
    """
    digest = hashlib.sha256(repr(basis.nodes_nm).encode())
    for images in (basis.layers, basis.noise):
        for light in sorted(images):
            digest.update(light.encode() + images[light].tobytes())
    return digest.hexdigest()

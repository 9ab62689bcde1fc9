"""The pixels of one view: which rays they get, and how they gather them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometry.geometry import FloatArray
from scenes.projection.regions import (
    Box,
    dilated,
    edge_normals,
    frame_box,
    marker_box,
    marker_pixels,
    target_box,
    uniform_pixels,
)
from scenes.render import density, lattice
from scenes.render.blur import Blur
from scenes.render.carriers import carriers
from scenes.render.lanes import BLOCK, CHOICES, Segment
from scenes.view import Quality, TransportBasis, View

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

#: Rays a pixel of the marker's plate, between and around its ArUco and elements.
_PLATE_RAYS = 16
#: How often pixels that are too noisy get more rays.
_ROUNDS = 6
#: Rows of a matrix multiplied at once.
_PRODUCT_ROWS = 16


@dataclass(frozen=True, eq=False)
class Part:
    """Pixels that share a lattice.

    Attributes:
        segment: the view and the lattice.
        tiles: a box, or columns and rows (n, 2).
        half: which of the two renderings it belongs to, or None for both.
        sign: 1, or −1 to remove what was added before.
        like: the lattice of the neighbouring pixels, where these pixels have fewer rays in its place; None for none.
    """

    segment: Segment
    tiles: Box | NDArray[np.int32]
    half: int | None
    sign: int = 1
    like: Segment | None = None


@dataclass
class _Layer:
    """A part of the marker that has one lattice in each half.

    `mask` marks its pixels on the patch, `even` those pixels of uniform light that need few rays.
    """

    name: str
    mask: Mask
    segments: tuple[Segment, Segment]
    even: Mask

    @property
    def rays(self) -> int:
        """Rays of both halves."""
        few = int((self.mask & self.even).sum())
        return 2 * (few * BLOCK + (int(self.mask.sum()) - few) * self.segments[0].count)


class ViewImage:
    """Collects the rays of one view.

    Pixels are gathered on the frame, grown by the blur that a wide point spread needs (`_canvas`). Those around the marker
    (`_patch`) are gathered twice, on the marker's box grown by the reach of the kernel (`_zone`).
    """

    def __init__(self, view: View, quality: Quality) -> None:
        self.view, self.quality = view, quality
        self._blur = Blur.of(view.camera.psf_sigma_px, view.defocus_px)
        self._sigma = self._blur.gathered_px
        self._reach = lattice.reach_px(self._sigma)
        self._canvas = frame_box(view).grown(self._blur.reach_px)
        seen = self._canvas.grown(self._reach)
        self._patch = marker_box(view).within(seen)
        self._zone = self._patch.grown(self._reach)
        self._frame_segment = self._segment(density.lattice_size(quality.frame_samples**2), 0, 0)
        self._pixels: dict[str, Mask] = {}
        self._layers: list[_Layer] = []
        self._plate: Segment | None = None
        self._even: tuple[Segment, Segment] | None = None
        self._round = 0
        self._tables: dict[Segment, Image] = {}
        self._weights: list[FloatArray] = []
        self._found: FloatArray | None = None
        #: What is to be traced and added first.
        self.parts = [*self._marker_parts(), *self._frame_parts(seen)]
        #: Wavelengths to trace, and how all others follow from them.
        self.carriers_nm, self._mixture = carriers(view.target.materials, view.nodes_nm)
        channels = len(view.lights) * len(self.carriers_nm)
        self._common = np.zeros((channels, self._canvas.height, self._canvas.width), np.float32)
        self._halves = np.zeros((2, channels, self._zone.height, self._zone.width))

    # --- which rays

    def _segment(self, count: int, half: int, stream: int) -> Segment:
        rng = np.random.default_rng((self.quality.seed, stream, half))
        generator = lattice.generator(count, edge_normals(self.view), rank=half)
        return Segment(self.view, count, generator, rng.random(2), rng.random(CHOICES))

    def _marker_parts(self) -> list[Part]:
        patch = self._patch
        if not patch.width or not patch.height:
            return []
        seen = marker_pixels(self.view, patch)
        self._pixels = {"aruco": seen.aruco, "blob": seen.blob, "slats": seen.opening & ~seen.blob}
        reach = self._reach + self._blur.reach_px
        masks, taken = {}, np.zeros_like(seen.aruco)
        for name in ("blob", "aruco", "slats"):  # where they meet, the densest counts
            masks[name] = dilated(self._pixels[name], reach) & ~taken
            taken |= masks[name]
        rays = density.rays_per_pixel(self.quality, {name: int(mask.sum()) for name, mask in masks.items()})
        if min(rays.values()) < BLOCK:  # the whole patch evenly
            everywhere = np.ones_like(taken)
            self._layers = [_Layer("", everywhere, self._both(min(rays.values()), 1), ~everywhere)]
            return [Part(segment, patch, half) for half, segment in enumerate(self._layers[0].segments)]
        even = uniform_pixels(self.view, patch)
        self._layers = [
            _Layer(name, mask, self._both(rays[name], stream), even)
            for stream, (name, mask) in enumerate(masks.items(), 1)
        ]
        self._plate, self._even = self._segment(_PLATE_RAYS, 0, len(masks) + 1), self._both(BLOCK, len(masks) + 2)
        parts = [part for layer in self._layers for part in self._parts_of(layer)]
        return [*parts, Part(self._plate, self._tiles(~taken), None)]

    def _both(self, count: int, stream: int) -> tuple[Segment, Segment]:
        return self._segment(count, 0, stream), self._segment(count, 1, stream)

    def _parts_of(self, layer: _Layer, sign: int = 1) -> list[Part]:
        edges, even = self._tiles(layer.mask & ~layer.even), self._tiles(layer.mask & layer.even)
        parts = [Part(segment, edges, half, sign) for half, segment in enumerate(layer.segments)]
        if len(even):
            assert self._even is not None
            parts += [Part(self._even[half], even, half, sign, like) for half, like in enumerate(layer.segments)]
        return parts

    def _tiles(self, mask: Mask) -> NDArray[np.int32]:
        row, column = np.nonzero(mask)
        return np.stack([column + self._patch.x0, row + self._patch.y0], axis=-1).astype(np.int32)

    def _frame_parts(self, seen: Box) -> list[Part]:
        """The rest of the frame that may show the target or the Earth's disc; nothing where it may stay dark."""
        if self.quality.frame_samples == 0:
            return []
        box = seen if self.view.earth is not None else target_box(self.view).within(seen)
        return [Part(self._frame_segment, part, None) for part in box.around(self._patch.within(box))]

    def more(self) -> list[Part]:
        """What to trace and add next, because pixels of the marker are noisier than the quality allows.

        The rays of these pixels are removed and more of them take their place. Empty when all is well or the rays are used
        up.
        """
        if self._plate is None or self._round == _ROUNDS:
            return []
        self._round += 1
        found = self._found = self._fractions()
        noisy = dilated(found > self.quality.variance_fraction, self._reach)
        spent = sum(layer.rays for layer in self._layers)
        parts: list[Part] = []
        for layer in list(self._layers):
            mask = layer.mask & noisy
            if not mask.any():
                continue
            before = layer.segments[0].count
            after = density.more_rays(before, float(found[dilated(mask, self._reach)].max()), self.quality)
            stream = len(density.PARTS) + 1 + self._round * len(density.PARTS) + density.PARTS.index(layer.name)
            dense = _Layer(layer.name, mask, self._both(after, stream), np.zeros_like(mask))
            away = replace(layer, mask=mask)
            if after == before or spent + dense.rays - away.rays > self.quality.marker_rays:
                continue
            spent += dense.rays - away.rays
            parts += self._parts_of(away, sign=-1) + self._parts_of(dense)
            layer.mask = layer.mask & ~mask
            self._layers.append(dense)
        if parts:
            self._weights, self._found = [], None
        return parts

    # --- gathering

    def add_box(self, part: Part, box: Box, channels: list[Image]) -> None:
        """Add the rays of a box of pixels.

        Args:
            part: that the box belongs to.
            box: the pixels.
            channels: by light and wavelength, (height, width, rays).
        """
        reach, target = self._reach, self._common if part.half is None else self._halves[part.half]
        origin = self._canvas if part.half is None else self._zone
        grown = box.grown(reach)
        kept = grown.within(origin)
        there, here = kept.slices(origin), kept.slices(grown)
        positions = part.segment.positions
        across, along = (lattice.axis_weights(positions[:, k], self._sigma)[:, ::-1] for k in (0, 1))
        for image, channel in zip(target, channels, strict=True):
            for s in range(len(positions)):
                rays = np.pad(channel[:, :, s], reach)
                image[there] += _filtered(rays, across[s], along[s] / len(positions))[here]

    def add_tiles(self, part: Part, tiles: NDArray[np.int32], channels: list[Image]) -> None:
        """Add the rays of single pixels.

        Args:
            part: that the pixels belong to.
            tiles: columns and rows of the pixels, (n, 2).
            channels: by light and wavelength, (n, rays).
        """
        table = self._table(part.segment)
        if part.like is not None:
            table = lattice.in_place_of(table, self._table(part.like))
        zone, reach = self._zone, self._reach
        offset = np.arange(-reach, reach + 1)
        row = tiles[:, 1, None, None] - zone.y0 + offset[:, None]
        column = tiles[:, 0, None, None] - zone.x0 + offset
        index = (row * zone.width + column).ravel()
        halves = (0, 1) if part.half is None else (part.half,)
        for k, channel in enumerate(channels):
            spread = np.bincount(index, _product(channel, table).ravel(), zone.height * zone.width)
            for half in halves:
                self._halves[half, k] += part.sign * spread.reshape(zone.height, zone.width)

    def finish(self) -> TransportBasis:
        """The basis of the view, once all its parts have been added. This uses up the arrays."""
        view, canvas = self.view, self._canvas
        statement = self._statement()
        images = self._common
        noise = np.zeros((len(view.lights), *images.shape[1:]), np.float32)
        kept = self._patch_image()
        if kept is not None:
            where, mean, draw = kept
            images[(slice(None), *where.slices(canvas))] = mean
            noise[(slice(None), *where.slices(canvas))] = draw
        frame, count = frame_box(view).slices(canvas), len(self.carriers_nm)
        layers, draws = {}, {}
        for k, light in enumerate(view.lights):
            carried = np.stack([self._blurred(i)[frame] for i in images[k * count : (k + 1) * count]])
            # Not by BLAS, whose bits depend on its threads. Black may come out an ulp below zero.
            mixed = np.einsum("nc,cyx->nyx", self._mixture.astype(np.float32), carried)
            layers[light] = np.maximum(mixed, 0)
            draws[light] = self._blurred(noise[k])[frame].copy()
        return TransportBasis(view.nodes_nm, layers, statement, draws)

    def _patch_image(self) -> tuple[Box, FloatArray, FloatArray] | None:
        """The part of the canvas that the marker's surroundings cover, its channels, and a sample of their noise by light.

        The noise is averaged over the wavelengths.
        """
        kept = self._zone.within(self._canvas)
        if not self._layers or not kept.width or not kept.height:
            return None
        there, here = kept.slices(self._canvas), kept.slices(self._zone)
        common = self._common[(slice(None), *there)]
        self._weights = self._weights or [self._weight(half) for half in (0, 1)]
        first, second = (
            (common + self._halves[half][(slice(None), *here)]) / self._weights[half][here] for half in (0, 1)
        )
        return kept, (first + second) / 2, self._over_nodes((first - second) / 2)

    def _over_nodes(self, channels: FloatArray) -> FloatArray:
        """Mean over the wavelengths of carriers' channels (lights × carriers, height, width), (lights, height, width)."""
        by_light = channels.reshape(len(self.view.lights), -1, *channels.shape[1:])
        return np.einsum("lcyx,c->lyx", by_light, self._mixture.mean(axis=0))

    def _fractions(self) -> FloatArray:
        """The renderer's variance over shot variance on the patch's pixels of ArUco and elements.

        The largest of the lights counts. Each light is taken by itself, in the exposure that brings the ArUco's brightest
        pixels to the charge that the quality names.
        """
        result = np.zeros((self._patch.height, self._patch.width))
        seen = self._patch.within(frame_box(self.view))
        kept = self._patch_image()
        if kept is None or not seen.width or not seen.height:
            return result
        where, mean, noise = kept
        from_here, on_patch = seen.slices(where), seen.slices(self._patch)
        pixels = np.any(list(self._pixels.values()), axis=0)[on_patch]
        for k, level in enumerate(self._over_nodes(mean)):
            image = self._blurred(level.astype(np.float32))[from_here]
            draw = self._blurred(noise[k].astype(np.float32))[from_here]
            scale = density.electrons_per_radiance(image[self._pixels["aruco"][on_patch]], self.quality)
            found = density.variance_fractions(draw * scale, image * scale, pixels)
            result[on_patch] = np.maximum(result[on_patch], found)
        return result

    def _statement(self) -> dict[str, str | float]:
        """Rays per pixel and largest share of shot variance by part of the marker, and the charge at which it holds."""
        if not self._pixels:
            return {}
        told: dict[str, str | float] = {"shot_noise_electrons": self.quality.electrons}
        found = self._fractions() if self._found is None else self._found
        for name, mask in self._pixels.items():
            layers = [layer for layer in self._layers if layer.name in (name, "") and layer.mask.any()]
            pixels = sum(int(layer.mask.sum()) for layer in layers)
            rays = sum(layer.rays for layer in layers)
            told[f"{name}_rays_per_pixel"] = rays / pixels if pixels else 0.0
            if mask.any():
                told[f"{name}_variance_fraction"] = float(found[mask].max())
        return told

    def _weight(self, half: int) -> FloatArray:
        """Sum of the weights that each pixel of the zone gathered: one except along seams between lattices."""
        reach = self._reach
        outside = np.ones((self._patch.height + 4 * reach, self._patch.width + 4 * reach), np.float32)
        inner = (slice(2 * reach, -2 * reach),) * 2 if reach else (slice(None),) * 2
        outside[inner] = 0
        total = self._spread(outside, self._frame_segment)
        lattices = [(layer.mask, layer.segments[half]) for layer in self._layers]
        if self._plate is not None:
            lattices.append((~np.any([layer.mask for layer in self._layers], axis=0), self._plate))
        for mask, segment in lattices:
            inside = np.zeros_like(outside)
            inside[inner] = mask
            total += self._spread(inside, segment)
        edge = (slice(reach, -reach),) * 2 if reach else (slice(None),) * 2
        return total[edge].astype(float)

    def _spread(self, mask: Image, segment: Segment) -> Image:
        side = 2 * self._reach + 1
        kernel = self._table(segment).sum(axis=0).reshape(side, side)[::-1, ::-1]
        return np.asarray(cv2.filter2D(mask, cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT), np.float32)

    def _table(self, segment: Segment) -> Image:
        """Weights of a segment's rays, computed once."""
        if segment not in self._tables:
            self._tables[segment] = lattice.weights(segment.positions, self._sigma)
        return self._tables[segment]

    def _blurred(self, image: Image) -> Image:
        if not self._blur.rest_px:
            return image
        return np.asarray(
            cv2.filter2D(np.ascontiguousarray(image), cv2.CV_32F, self._kernel, borderType=cv2.BORDER_CONSTANT),
            np.float32,
        )

    @cached_property
    def _kernel(self) -> Image:
        return self._blur.kernel()


def _filtered(image: Image, across: FloatArray, along: FloatArray) -> Image:
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, across, along, borderType=cv2.BORDER_CONSTANT), np.float32)


def _product(rows: Image, table: Image) -> Image:
    """Rows @ table in small pieces, for which BLAS starts no threads: they would compete with the renderer's."""
    whole = len(rows) // _PRODUCT_ROWS * _PRODUCT_ROWS
    pieces = rows[:whole].reshape(-1, _PRODUCT_ROWS, rows.shape[1])
    return np.concatenate([(pieces @ table).reshape(whole, table.shape[1]), rows[whole:] @ table])

"""Many views rendered together: the rays of all of them are lanes of one kernel launch, a fixed number of lanes at a time.

The frame of a view is sampled coarsely, its marker densely, and the elements more densely than the ArUco. Every pixel has a
lattice of rays. Each ray counts in all pixels around it, weighted by the point spread ⊗ pixel kernel at its place, so that
neighbours share rays. ArUco and elements are rendered twice with independent lattices: the mean is the result, and half the
difference is a sample of its error. The image of a view depends on the view and the quality alone, not on what is rendered
beside it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from scenes.projection.regions import Box
from scenes.render.image import Image, Part, ViewImage
from scenes.render.lanes import BLOCK, Segment
from scenes.render.tracer import Kind, Traced, trace
from scenes.view import Quality, TransportBasis, View

#: Lanes traced at once: eight numbers a lane and two launches under way take half a gigabyte.
LANES = 4 * 2**20
_VIEWS = 16
#: A job's most lanes: a part of a view that is traced and gathered in one go.
_JOB_LANES = 2**20


def render_bases(views: Iterable[View], quality: Quality | None = None) -> Iterator[TransportBasis]:
    """Render every light of many views, in order.

    Views in a row that differ only in pose and lights share kernel launches.

    Args:
        views: taken as they are needed, some way ahead of the results.
        quality: of all of them; default `Quality()`.

    Raises:
        RuntimeError: when no Mitsuba variant can run here.
    """
    chosen = quality or Quality()
    return render_cases((view, chosen) for view in views)


def render_cases(cases: Iterable[tuple[View, Quality]]) -> Iterator[TransportBasis]:
    """Render every light of many views, each with a quality of its own, in order; see `render_bases`.

    Args:
        cases: views with their qualities, taken as they are needed.

    Raises:
        RuntimeError: when no Mitsuba variant can run here.
    """
    from scenes.llvm import activate_variant

    if activate_variant().startswith("scalar"):
        from scenes.render.stock import render_stock_basis

        yield from (render_stock_basis(*case) for case in cases)
        return
    for _, same in groupby(cases, lambda case: (Kind.of(case[0]), case[0].nodes_nm)):
        yield from _render_alike(ViewImage(*case) for case in same)


def _render_alike(images: Iterable[ViewImage]) -> Iterator[TransportBasis]:
    """Render views of one kind.

    One launch is gathered while the next is traced. Views that need more rays get them with a later launch; the results
    still come in the order of the views.
    """
    flying: deque[tuple[list[_Job], list[Traced]]] = deque()
    order: deque[ViewImage] = deque()
    done: set[ViewImage] = set()
    extra: deque[_Job] = deque()

    def jobs() -> Iterator[_Job]:
        for image in images:
            order.append(image)
            yield from _jobs(image, image.parts)
            while extra:
                yield extra.popleft()

    def land() -> Iterator[TransportBasis]:
        for image in _gather(*flying.popleft()):
            if parts := image.more():
                extra.extend(_jobs(image, parts))
            else:
                done.add(image)
        while order and order[0] in done:
            done.remove(order[0])
            yield order.popleft().finish()

    for batch in _batches(jobs()):
        flying.append(_launch(batch))
        if len(flying) > 1:
            yield from land()
    while flying or extra:
        if extra:
            rest = list(extra)
            extra.clear()
            flying.extend(_launch(batch) for batch in _batches(rest))
        yield from land()


def _batches(jobs: Iterable[_Job]) -> Iterator[list[_Job]]:
    """Jobs in lists of `LANES` lanes or slightly more, from at most `_VIEWS` views."""
    batch: list[_Job] = []
    lanes = views = 0
    for job in jobs:
        batch.append(job)
        lanes, views = lanes + job.lanes, views + job.last
        if lanes >= LANES or views >= _VIEWS:
            yield batch
            batch, lanes, views = [], 0, 0
    if batch:
        yield batch


def _launch(jobs: list[_Job]) -> tuple[list[_Job], list[Traced]]:
    view, nodes_nm = jobs[0].image.view, jobs[0].image.carriers_nm
    segments = [job.segment for job in jobs]
    blocks = np.concatenate([job.blocks(k) for k, job in enumerate(jobs)])
    return jobs, [trace(Kind.of(view), segments, blocks, nodes_nm[k : k + 4]) for k in range(0, len(nodes_nm), 4)]


def _gather(jobs: list[_Job], traced: list[Traced]) -> Iterator[ViewImage]:
    """Give every job's lanes to its image; yields each image that has then received everything it asked for."""
    spectra: dict[str, list[Image]] = {}
    for group in traced:
        for light, arrays in group.arrays().items():
            spectra.setdefault(light, []).extend(arrays)
    channels = [array for light in jobs[0].image.view.lights for array in spectra[light]]
    first = 0
    for job in jobs:
        job.gather([channel[first : first + job.lanes] for channel in channels])
        first += job.lanes
        if job.last:
            yield job.image


def _jobs(image: ViewImage, parts: list[Part]) -> Iterator[_Job]:
    """Parts of a view in pieces of `_JOB_LANES` lanes or slightly more."""
    pieces = [piece for part in parts for piece in _pieces(part)]
    for k, (part, tiles) in enumerate(pieces):
        yield _Job(image, part, tiles, last=k == len(pieces) - 1)


def _pieces(part: Part) -> Iterator[tuple[Part, Box | NDArray[np.int32]]]:
    count, tiles = part.segment.count, part.tiles
    if isinstance(tiles, Box):
        rows = max(1, _JOB_LANES // (_block_width(tiles.width, count) * count))
        for y in range(tiles.y0, tiles.y1, rows):
            yield part, Box(tiles.x0, y, tiles.x1, min(y + rows, tiles.y1))
    else:
        size = max(1, _JOB_LANES // count)
        for first in range(0, len(tiles), size):
            yield part, tiles[first : first + size]


def _block_width(width: int, count: int) -> int:
    """Columns to trace of a box with a number of rays per pixel, so that they fill whole blocks of lanes."""
    per_block = max(1, BLOCK // count)
    return -(-width // per_block) * per_block


@dataclass
class _Job:
    """Some pixels of a part of a view: a box, or columns and rows (n, 2)."""

    image: ViewImage
    part: Part
    tiles: Box | NDArray[np.int32]
    last: bool

    @property
    def segment(self) -> Segment:
        return self.part.segment

    @property
    def lanes(self) -> int:
        if isinstance(self.tiles, Box):
            return self.tiles.height * _block_width(self.tiles.width, self.segment.count) * self.segment.count
        return len(self.tiles) * self.segment.count

    def blocks(self, segment: int) -> NDArray[np.int32]:
        """Blocks (n, 4) for `tracer.trace`: segment, first pixel and first lattice point of `BLOCK` lanes."""
        count, tiles = self.segment.count, self.tiles
        if isinstance(tiles, Box):
            columns = np.arange(tiles.x0, tiles.x1, max(1, BLOCK // count))
            column, row = np.meshgrid(columns, np.arange(tiles.y0, tiles.y1))
            tiles = np.stack([column, row], axis=-1).reshape(-1, 2).astype(np.int32)
        points = np.arange(0, count, BLOCK)
        result = np.empty((len(tiles), len(points), 4), np.int32)
        result[..., 0], result[..., 1:3], result[..., 3] = segment, tiles[:, None], points
        return result.reshape(-1, 4)

    def gather(self, channels: list[Image]) -> None:
        """Add its lanes, an array of each light and wavelength, to the image."""
        count = self.segment.count
        if isinstance(self.tiles, Box):
            shape = (self.tiles.height, _block_width(self.tiles.width, count), count)
            self.image.add_box(self.part, self.tiles, [c.reshape(shape)[:, : self.tiles.width] for c in channels])
        else:
            self.image.add_tiles(self.part, self.tiles, [c.reshape(-1, count) for c in channels])

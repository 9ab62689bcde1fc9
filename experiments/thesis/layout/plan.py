"""What the layout study walks through."""

from __future__ import annotations

from dataclasses import dataclass, replace

from experiments.thesis.layout.placement import Kind


@dataclass(frozen=True)
class RenderedCase:
    """A layout, scaled to its face, that is rendered.

    Attributes:
        kind: of the layout.
        face_m: side of the face [m].
        ranges_m: ranges at which it is rendered [m].
    """

    kind: Kind
    face_m: float
    ranges_m: tuple[float, ...]


@dataclass(frozen=True)
class ShownFrame:
    """A frame that the page shows.

    Attributes:
        kind, face_m: layout and side of its face [m].
        range_m: of the face [m].
        attitude_deg: pitch, yaw and roll [deg].
    """

    kind: Kind
    face_m: float
    range_m: float
    attitude_deg: tuple[float, float, float]


@dataclass(frozen=True)
class Plan:
    """What is counted, rendered and shown.

    Attributes:
        faces_m, ranges_m: sides of the faces and ranges of the counts [m].
        attitudes: number of random attitudes of the counts.
        cases: layouts and ranges that are rendered.
        poses: attitudes rendered of each case and range.
        draws: noise draws of each attitude.
        rays: traced on each marker.
        shown: frames that the page shows.
    """

    faces_m: tuple[float, ...]
    ranges_m: tuple[float, ...]
    attitudes: int
    cases: tuple[RenderedCase, ...]
    poses: int
    draws: int
    rays: int
    shown: tuple[ShownFrame, ...] = ()


_RENDERED_M = (1.0, 2.0, 3.0, 5.0, 8.0, 10.0, 12.0, 15.0)

FULL = Plan(
    faces_m=(1.0, 2.0, 5.0, 10.0),
    ranges_m=tuple(float(r) for r in range(1, 21)),
    attitudes=400,
    cases=(RenderedCase("wide", 1.0, _RENDERED_M), RenderedCase("narrow", 1.0, _RENDERED_M)),
    poses=6,
    draws=4,
    rays=500_000,
    shown=(
        ShownFrame("wide", 1.0, 1.0, (10.0, -15.0, 5.0)),
        ShownFrame("wide", 1.0, 5.0, (20.0, -15.0, 30.0)),
        ShownFrame("narrow", 1.0, 5.0, (20.0, -15.0, 30.0)),
        ShownFrame("nested", 2.0, 5.0, (20.0, -15.0, 30.0)),
    ),
)
QUICK = replace(
    FULL,
    faces_m=(1.0, 10.0),
    ranges_m=(1.0, 5.0, 20.0),
    attitudes=20,
    cases=(RenderedCase("wide", 1.0, (5.0,)),),
    poses=1,
    draws=1,
    rays=60_000,
    shown=FULL.shown[1:2],
)

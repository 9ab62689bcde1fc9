"""The marker's files describe the same body that is rendered."""

from __future__ import annotations

import json
import re
import struct

import numpy as np
import pytest

from scenes.files.marker_files import body_solids, feature_points, tape_sheet, write_marker_files
from scenes.marker import MarkerDesign

MARKERS = [
    MarkerDesign(),
    MarkerDesign(size_m=0.2, slit_count=10, ring_fraction=0.06),
    MarkerDesign(size_m=0.05, identity=7),
]


def _volume(triangles: np.ndarray) -> float:
    """Volume enclosed by triangles (n, 3, 3) wound outwards: divergence theorem."""
    return float(np.sum(triangles[:, 0] * np.cross(triangles[:, 1], triangles[:, 2])) / 6)


def _read_stl(data: bytes) -> np.ndarray:
    count = struct.unpack("<I", data[80:84])[0]
    records = np.frombuffer(
        data[84:], np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    )
    assert len(records) == count
    return records["corners"].astype(float)


@pytest.mark.parametrize("marker", MARKERS, ids=lambda m: f"{m.size_m:g}m")
def test_every_solid_is_closed_and_wound_outwards(marker, tmp_path):
    write_marker_files(marker, tmp_path)
    triangles = _read_stl((tmp_path / "marker.stl").read_bytes()).reshape(-1, 12, 3, 3)
    for solid in triangles:
        edges = {}
        for triangle in solid:
            for a, b in ((0, 1), (1, 2), (2, 0)):
                key = (tuple(triangle[a]), tuple(triangle[b]))
                edges[key] = edges.get(key, 0) + 1
        # In a closed, consistently wound surface every directed edge meets its reverse exactly once.
        assert all(count == 1 and edges.get((b, a)) == 1 for (a, b), count in edges.items())
        assert _volume(solid) > 0


@pytest.mark.parametrize("marker", MARKERS, ids=lambda m: f"{m.size_m:g}m")
def test_solids_leave_exactly_the_slits_open(marker):
    """Sum of the solids' volumes = bounding box minus the slits, which are prisms between front and floor."""
    solids = body_solids(marker)
    from scenes.files.marker_files import _FACES

    total = sum(_volume(solid[_FACES]) for solid in solids)
    e = marker.elements[0]
    shrink = 1 - e.depth_m / e.virtual_depth_m
    open_top = e.length_m * (1 - marker.slat_fraction)
    slits = 4 * e.width_m * e.depth_m * open_top * (1 + shrink) / 2
    box = marker.size_m**2 * marker.thickness_m
    assert total == pytest.approx(box - slits, rel=1e-9)


def test_obj_holds_the_rendered_triangles_in_metres_and_three_materials(tmp_path):
    marker = MarkerDesign()
    write_marker_files(marker, tmp_path)
    text = (tmp_path / "marker.obj").read_text()
    assert re.findall(r"^usemtl (\w+)", text, re.M) == ["retro", "absorber", "base"]
    vertices = np.array([line.split()[1:] for line in text.splitlines() if line.startswith("v ")], float)
    assert np.abs(vertices[:, :2]).max() == pytest.approx(marker.size_m / 2)
    faces = sum(line.startswith("f ") for line in text.splitlines())
    assert faces == sum(len(f) for _, f in marker.meshes().values()) + 2


def test_tape_sheet_is_true_to_scale_and_shows_all_tape():
    marker = MarkerDesign()
    svg = tape_sheet(marker)
    width, height = (float(re.search(rf'{key}="([\d.]+)mm"', svg)[1]) for key in ("width", "height"))
    assert [float(v) for v in re.search(r'viewBox="([^"]+)"', svg)[1].split()] == [0, 0, width, height]
    group = svg[svg.index('<g fill="#bbb"') :]
    area = sum(float(w) * float(h) for w, h in re.findall(r'width="([\d.]+)" height="([\d.]+)"', group))
    vertices, faces = marker.meshes()["retro"]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    rendered = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 * 1e6
    assert area == pytest.approx(rendered, rel=1e-4)


def test_feature_points_are_plain_data_of_the_design(tmp_path):
    marker = MarkerDesign(size_m=0.2)
    write_marker_files(marker, tmp_path)
    data = json.loads((tmp_path / "marker.json").read_text())
    assert data == json.loads(json.dumps(feature_points(marker)))
    assert MarkerDesign(**data["design"]) == marker
    np.testing.assert_allclose(data["corners"], marker.corners_m)

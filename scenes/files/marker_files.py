"""The marker as things to make and to render: printable solids, an OBJ with materials, a tape sheet, and its feature points.

The body is a set of closed convex prisms that touch or overlap slightly, so that every slicer joins them: a back plate, the
block around the cavities, the wedges of the slanted end walls, and the slats.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from radiometry.geometry import FloatArray
from scenes.atomic import atomic_write
from scenes.marker import Element, MarkerDesign

#: Triangles of a hexahedron whose corners are bottom 0-3 and top 4-7, both counter-clockwise as seen from above.
_FACES = np.array(
    [
        [0, 2, 1],
        [0, 3, 2],
        [4, 5, 6],
        [4, 6, 7],
        [0, 1, 5],
        [0, 5, 4],
        [1, 2, 6],
        [1, 6, 5],
        [2, 3, 7],
        [2, 7, 6],
        [3, 0, 4],
        [3, 4, 7],
    ]
)


def write_marker_files(marker: MarkerDesign, folder: Path) -> list[Path]:
    """Write marker.stl [mm], marker.obj and marker.mtl [m], tape.svg (true to scale) and marker.json.

    Args:
        marker: the design.
        folder: where the files go.

    Returns:
        Paths of the files.

    Raises:
        OSError: when a file cannot be written.
    """
    writers = {
        "marker.stl": lambda: _stl(body_solids(marker)),
        "marker.obj": lambda: _obj(marker).encode(),
        "marker.mtl": lambda: _MATERIALS.encode(),
        "tape.svg": lambda: tape_sheet(marker).encode(),
        "marker.json": lambda: (json.dumps(feature_points(marker), indent=2) + "\n").encode(),
    }
    paths = []
    for name, write in writers.items():
        with atomic_write(folder / name) as temporary:
            temporary.write_bytes(write())
        paths.append(folder / name)
    return paths


def feature_points(marker: MarkerDesign) -> dict[str, object]:
    """Corners, virtual points, frames of the elements and the design itself as plain data in the marker frame [m].

    Args:
        marker: the design.
    """
    return {
        "unit": "m",
        "frame": "origin at the centre of the front plane, x right, y up, z out of the face",
        "corners": marker.corners_m.tolist(),
        "virtual_points": {name: point.tolist() for name, point in marker.virtual_points_m.items()},
        "elements": {
            e.name: {
                "centre": e.centre_m.tolist(),
                "along": e.along.tolist(),
                "across": e.across.tolist(),
                "length": e.length_m,
                "width": e.width_m,
                "depth": e.depth_m,
                "shift": e.shift_m,
                "virtual_offset": e.virtual_offset_m,
                "virtual_depth": e.virtual_depth_m,
            }
            for e in marker.elements
        },
        "shortcomings": list(marker.shortcomings()),
        "design": marker.model_dump(mode="json"),
    }


def body_solids(marker: MarkerDesign) -> FloatArray:
    """The marker's body as closed hexahedra.

    Args:
        marker: the design.

    Returns:
        Corners (n, 8, 3) [m]: bottom face 0-3 and top face 4-7, both counter-clockwise from above.
    """
    half, depth, back = marker.size_m / 2, marker.element_depth_m, marker.thickness_m
    solids = [_box(-half, half, -half, half, -back, -depth)]
    solids += [_box(x0, x1, y0, y1, -depth, 0.0) for x0, x1, y0, y1, _ in marker.plane_cells()]
    for element in marker.elements:
        solids += _element_solids(marker, element)
    return np.array([_upright(s) for s in solids])


def _box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> FloatArray:
    outline = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    return np.concatenate([np.column_stack([outline, np.full(4, z)]) for z in (z0, z1)])


def _element_solids(marker: MarkerDesign, e: Element) -> list[FloatArray]:
    """Slats and the wedges under the slanted end walls of one cavity."""
    shrink = 1 - e.depth_m / e.virtual_depth_m
    start, end, pitch = e.shift_m - e.length_m / 2, e.shift_m + e.length_m / 2, e.length_m / marker.slit_count
    half_slat = marker.slat_fraction * pitch / 2

    def down(u: float) -> float:
        return e.virtual_offset_m + (u - e.virtual_offset_m) * shrink

    spans = [(start + i * pitch - half_slat, start + i * pitch + half_slat) for i in range(1, marker.slit_count)]
    top_and_bottom = [((a, b), (down(a), down(b))) for a, b in spans]
    for side, edge in ((-1, start), (1, end)):  # end wall with the half slat that leans on it
        inner = edge - side * half_slat
        top, bottom = sorted((inner, edge)), sorted((down(inner), edge))
        top_and_bottom.append(((top[0], top[1]), (bottom[0], bottom[1])))
    solids = []
    for (a_top, b_top), (a_low, b_low) in top_and_bottom:
        corners = [(a_low, -e.depth_m), (b_low, -e.depth_m), (a_top, 0.0), (b_top, 0.0)]
        low, high = ([(u, v, z) for u, z in pair for v in (-1, 1)] for pair in (corners[:2], corners[2:]))
        solid = np.array([low[0], low[2], low[3], low[1], high[0], high[2], high[3], high[1]])
        across = solid[:, 1] * e.width_m / 2
        solids.append(
            e.centre_m + solid[:, :1] * e.along + across[:, None] * e.across + solid[:, 2:] * np.array([0, 0, 1.0])
        )
    return solids


def _upright(solid: FloatArray) -> FloatArray:
    """The same hexahedron wound counter-clockwise from above, whatever the handedness of the element's axes."""
    a, b = solid[5, :2] - solid[4, :2], solid[6, :2] - solid[4, :2]
    area = a[0] * b[1] - a[1] * b[0]
    return solid if area > 0 else solid[[0, 3, 2, 1, 4, 7, 6, 5]]


def _stl(solids: FloatArray) -> bytes:
    """Binary STL in millimetres."""
    triangles = (solids[:, _FACES] * 1000.0).reshape(-1, 3, 3)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    records = np.zeros(
        len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    )
    records["normal"], records["corners"] = normals, triangles
    return b"Mantis Marker, millimetres".ljust(80) + np.uint32(len(triangles)).tobytes() + records.tobytes()


_MATERIALS = "\n".join(
    f"newmtl {name}\nKd {grey} {grey} {grey}\n" for name, grey in (("retro", 0.9), ("absorber", 0.02), ("base", 0.3))
)


def _obj(marker: MarkerDesign) -> str:
    """Wavefront OBJ in metres: the optical surfaces as rendered, and the mounting plane as `base`."""
    half, back = marker.size_m / 2, -marker.thickness_m
    meshes = dict(marker.meshes())
    plane = np.array([(-half, -half, back), (-half, half, back), (half, half, back), (half, -half, back)])
    meshes["base"] = (plane, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))
    lines, first = ["# Mantis Marker, metres; x right, y up, z out of the face", "mtllib marker.mtl"], 1
    for material, (vertices, faces) in meshes.items():
        lines += [f"g {material}", f"usemtl {material}"]
        lines += ["v " + " ".join(f"{c:.9g}" for c in vertex) for vertex in vertices]
        lines += ["f " + " ".join(str(int(i) + first) for i in face) for face in faces]
        first += len(vertices)
    return "\n".join(lines) + "\n"


def tape_sheet(marker: MarkerDesign) -> str:
    """SVG of every piece of tape to cut, one user unit per millimetre: front cells in place, floors of the cavities beside them.

    Args:
        marker: the design.
    """
    mm = 1000.0
    size, gap = marker.size_m * mm, 10.0
    pieces = [
        (size / 2 + x0 * mm, size / 2 - y1 * mm, (x1 - x0) * mm, (y1 - y0) * mm)
        for x0, x1, y0, y1 in marker.reflective_rectangles_m()
    ]
    floors = []
    for k, e in enumerate(marker.elements):
        shrink = 1 - e.depth_m / e.virtual_depth_m
        floors.append((size + gap, 10.0 + k * (e.width_m * mm + gap), e.length_m * shrink * mm, e.width_m * mm, e.name))
    width, height = size + 2 * gap + floors[0][2], max(size, floors[-1][1] + floors[-1][3]) + gap
    rectangles = [f'<rect x="{x:.4f}" y="{y:.4f}" width="{w:.4f}" height="{h:.4f}"/>' for x, y, w, h in pieces]
    rectangles += [f'<rect x="{x:.4f}" y="{y:.4f}" width="{w:.4f}" height="{h:.4f}"/>' for x, y, w, h, _ in floors]
    labels = [
        f'<text x="{x:.2f}" y="{y - 2:.2f}">{name} floor, {w:.2f} × {h:.2f} mm</text>' for x, y, w, h, name in floors
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{height:.4f}mm" '
        f'viewBox="0 0 {width:.4f} {height:.4f}">\n'
        f"<title>Retroreflective tape of a {size:g} mm Mantis Marker, true to scale</title>\n"
        f'<rect x="0" y="0" width="{size:.4f}" height="{size:.4f}" fill="none" stroke="#888" stroke-width="0.1"/>\n'
        f'<g fill="#bbb" stroke="none">\n' + "\n".join(rectangles) + "\n</g>\n"
        '<g font-family="sans-serif" font-size="4">\n' + "\n".join(labels) + "\n</g>\n</svg>\n"
    )

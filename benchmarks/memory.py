"""Cost and memory over the number of poses."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

from benchmarks.rows import Row

TITLE = "Cost and memory over the number of poses"
TEXT = """
Poses of 64 × 64 px, coarsely sampled so that ten thousand take a minute, rendered one after the other in a process of
their own: its wall time and peak resident memory when so many are done. Cost should grow in proportion and memory not
at all.
"""
COLUMNS = "poses"
ONLY_DRAWN = True
_POINTS = (100, 300, 1000, 3000, 10_000)


def run(quick: bool) -> list[Row]:
    """Seconds and peak MiB after so many poses; their growth from 1000 to 10 000."""
    points = _POINTS[:3] if quick else _POINTS
    done = subprocess.run(
        [sys.executable, "-c", f"from benchmarks.memory import job; job({points!r})"],
        check=True,
        capture_output=True,
        text=True,
    )
    found = {int(n): values for n, values in json.loads(done.stdout.splitlines()[-1]).items()}
    rows = []
    low, high = points[-3] if quick else 1000, points[-1]
    growth = found[high]["mib"] / found[low]["mib"]
    rows.append(Row(f"peak memory at {high} poses over that at {low}", growth, "", "≤ 1.2"))
    slope = (found[high]["seconds"] / high) / (found[low]["seconds"] / low)
    rows.append(Row(f"seconds a pose at {high} over those at {low}", slope, ""))
    for n in points:
        rows.append(Row(str(n), found[n]["seconds"], "s", series="wall time"))
        rows.append(Row(str(n), found[n]["mib"], "MiB", series="peak memory"))
    return rows


def job(points: tuple[int, ...]) -> None:
    """Render poses, and print time and peak memory at some counts as JSON."""
    import resource
    import time
    from itertools import cycle, islice

    from benchmarks.scene import poses, scenario
    from scenes.render.transport import Quality, render_bases

    views = poses(scenario("camera.width_px=64", "camera.height_px=64", "range_m=3.3"), 100)
    quality = Quality(marker_rays=25_000)
    list(render_bases(views[:20], quality))
    start, found = time.perf_counter(), {}
    for done, _ in enumerate(render_bases(islice(cycle(views), points[-1]), quality), 1):
        if done in points:
            peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            found[done] = {"seconds": time.perf_counter() - start, "mib": peak_kib / 1024}
    print(json.dumps(found))


def figure(rows: list[Row]) -> Any:
    """Wall time and memory over poses."""
    from experiments.reporting.figures import COLOURS, MARKERS, new_figure

    fig, axes = new_figure(1, 2, (7.2, 3.0))
    for axis, name, unit, colour in zip(axes[0], ("wall time", "peak memory"), ("s", "MiB"), COLOURS, strict=False):
        points = [(int(row.figure), row.value) for row in rows if row.series == name]
        axis.plot(*zip(*points, strict=True), marker=MARKERS[0], color=colour, label="measured")
        axis.set(xscale="log", xlabel="poses", ylabel=f"{name} [{unit}]")
        if name == "wall time":
            n, seconds = points[-1]
            axis.plot(
                [p for p, _ in points], [seconds / n * p for p, _ in points], "--", color="0.5", label="in proportion"
            )
            axis.set_yscale("log")
            axis.legend()
        else:
            axis.set_ylim(0, 1.25 * max(v for _, v in points))
    return fig

"""The renderer as it was, in a checkout of its own; run there. Reads a request from stdin, answers on stdout, as JSON.

Request: scenario `overrides` by view, `seeds`, `out`. Answer: seconds of a pose in all, tracing, and gathering. The images of the
first view are kept in `out`, by light (seeds, height, width).
"""

from __future__ import annotations

import json
import sys
import time


def main() -> None:
    import numpy as np

    from experiments import chain
    from experiments.scenario import load_scenario
    from scenes.render import transport

    request = json.loads(sys.stdin.read())
    views = [chain.view(load_scenario(overrides=tuple(o))) for o in request["overrides"]]
    spent = {"trace": 0.0}
    trace = transport._trace

    def timed(*arguments):
        start = time.perf_counter()
        result = trace(*arguments)
        spent["trace"] += time.perf_counter() - start
        return result

    transport._trace = timed
    for view in views[:2]:
        transport.render_basis(view)
    spent["trace"] = 0.0
    start = time.perf_counter()
    for view in views:
        transport.render_basis(view)
    total = (time.perf_counter() - start) / len(views)
    traced = spent["trace"] / len(views)
    runs = [transport.render_basis(views[0], transport.Quality(seed=seed)).layers for seed in range(request["seeds"])]
    np.savez(request["out"], **{light: np.array([run[light][0] for run in runs]) for light in runs[0]})
    print("\n" + json.dumps({"all": total, "trace": traced, "gather": total - traced}))


if __name__ == "__main__":
    main()

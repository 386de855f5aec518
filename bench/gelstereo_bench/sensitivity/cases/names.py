"""Sequences in which it is hard to know which marker is which (`gelstereo_bench.frontier.sequences`)."""

from __future__ import annotations

from gelstereo import MarkerState, Params, Pipeline
from gelstereo_bench.frontier.scenes import VGA
from gelstereo_bench.frontier.sequences import SEQUENCES, Run, Shot
from gelstereo_bench.frontier.tracking import Method, Named, score
from gelstereo_bench.sensitivity.figures import Case, Evaluation

__all__ = ["load"]

#: Of the turned lattices every so manieth is enough.
_TURNED, _EVERY = "lattice turned by 0 to 345 deg", 5


def _thinned(name: str, runs: list[Run]) -> list[Run]:
    return runs[::_EVERY] if name == _TURNED else runs


def load() -> dict[str, Case]:
    """Simulate all sequences."""
    tasks = [(task, _thinned(task.name, list(task.make()))) for task in SEQUENCES]

    def evaluate() -> Evaluation:
        out = Evaluation()
        for task, runs in tasks:
            params = Params.preset("fast").replace(dict(task.changes))

            def begin(_: Shot, params: Params = params) -> Method:
                pipeline = Pipeline(VGA.rig(), params)

                def method(shot: Shot) -> Named:
                    frame = pipeline.process(shot.left, shot.right)
                    out.see([frame.digest])
                    return Named(frame.left_px, frame.right_px, frame.state == MarkerState.SEEN, frame.cols)

                return method

            found = score(task, runs, begin)
            out.see([found.refused])
            shown = max(found.right + found.switched + found.unseen, 1)
            out.figures[f"{task.name}: labelled, %"] = 100.0 * found.right / shown
            out.figures[f"{task.name}: wrong names"] = found.switched
            out.figures[f"{task.name}: failed frames"] = found.refused
        return out

    return {"names": Case(evaluate)}

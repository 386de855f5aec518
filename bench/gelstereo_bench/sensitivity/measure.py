"""Scales one constant after the other in the loaded scratch build, and evaluates the cases of its stage."""

from __future__ import annotations

import importlib
import itertools
import multiprocessing
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path

from gelstereo_bench.sensitivity import results
from gelstereo_bench.sensitivity.cases import cases_of
from gelstereo_bench.sensitivity.figures import Case, Evaluation, change
from gelstereo_bench.sensitivity.native import Constants
from gelstereo_bench.sensitivity.results import Entry, Result

__all__ = ["Options", "measure"]

#: A constant's evaluations may take so long before they count as endless, s.
_PATIENCE_S = 240.0
#: Figures that are kept for each factor.
_KEPT = 5


@dataclass(frozen=True)
class Options:
    """How much is tried, and on how many processes."""

    jobs: int = 2
    #: Only factors of 0.5 and 2.
    outer: bool = False
    #: Only constants whose file begins so.
    only: str = ""


@dataclass(frozen=True)
class _Loaded:
    case: Case
    default: Evaluation
    #: Numbers of the constants that are read in advance, and in the evaluation.
    prepared: set[int]
    read: set[int]


def _load(name: str, constants: Constants, count: int) -> dict[str, _Loaded]:
    """All cases of a file, evaluated once."""
    cases: dict[str, Case] = importlib.import_module(f"gelstereo_bench.sensitivity.cases.{name}").load()

    def read() -> set[int]:
        return {number for number in range(count) if constants.was_read(number)}

    prepared: dict[Callable[[], None], set[int]] = {}
    loaded = {}
    for key, case in cases.items():
        if case.prepare not in prepared:
            read()
            case.prepare()
            prepared[case.prepare] = read()
        read()
        default = case.evaluate()
        found = read()
        began = time.monotonic()
        if case.evaluate().digest != default.digest:
            raise RuntimeError(f"{key}: two evaluations differ")
        took_s = time.monotonic() - began
        print(
            f"{key}: {took_s:.1f} s an evaluation, {len(prepared[case.prepare] | found)} constants",
            flush=True,
        )
        loaded[key] = _Loaded(case, default, prepared[case.prepare], found)
    return loaded


def _compared(default: Evaluation, found: Evaluation) -> Result:
    """What changed, the largest first."""
    changes = {
        name: change(name, value, found.figures.get(name, float("nan")), default.least.get(name, 0.0))
        for name, value in default.figures.items()
    }
    most = sorted(changes, key=lambda name: -changes[name])
    figures = [
        (name, _short(default.figures[name]), _short(found.figures[name]))
        for name in most[:_KEPT]
        if changes[name] >= 1.0
    ]
    differs = default.digest != found.digest or changes[most[0]] > 0.0
    return Result(_short(changes[most[0]]), differs, figures)


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def _child(pipe: Connection, constants: Constants, number: int, cases: list[_Loaded], outer: bool) -> None:
    """Send a result for each factor."""
    # Panics tell themselves.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    most = 0.0
    for factor in results.FACTORS:
        if factor not in (0.5, 2.0) and (outer or most < 1.0):
            break
        pipe.send(("begun", factor))
        constants.scale(number, factor)
        merged, prepared = Result(), set()
        for each in cases:
            try:
                if number in each.prepared and each.case.prepare not in prepared:
                    prepared.add(each.case.prepare)
                    each.case.prepare()
                found = _compared(each.default, each.case.evaluate())
            except BaseException as error:
                panics = "Panic" in type(error).__name__
                found = Result(1e3, True, [], "panics" if panics else type(error).__name__)
            merged = _merged(merged, found)
        most = max(most, merged.most)
        pipe.send(("done", factor, merged))
    pipe.send(("end",))


def _merged(first: Result, second: Result) -> Result:
    """The larger changes of two cases."""
    figures = first.figures + second.figures
    return Result(
        max(first.most, second.most),
        first.differs or second.differs,
        (figures if first.most >= second.most else second.figures + first.figures)[:_KEPT],
        first.failed or second.failed,
    )


@dataclass
class _Running:
    key: str
    entry: Entry
    process: multiprocessing.process.BaseProcess
    pipe: Connection
    began: float
    factor: float = 0.0


def measure(
    path: Path, values: dict[str, str], numbers: dict[str, int], left: dict[str, str], options: Options
) -> None:
    """Fill the file with what it lacks; every constant is written when it is done."""
    entries = results.load(path)
    todo = [key for key, value in values.items() if key not in entries or entries[key].value != value]
    for key in todo:
        if key in left:
            entries[key] = Entry(values[key], left[key])
    todo = [key for key in todo if key not in left and key.startswith(options.only)]
    constants = Constants()
    files = dict.fromkeys(file for key in todo for file in cases_of(key))
    loaded = {file: _load(file, constants, len(numbers)) for file in files}
    waiting, done, began = iter(todo), 0, time.monotonic()
    running: list[_Running] = []
    while True:
        for key in itertools.islice(waiting, options.jobs - len(running)):
            cases = {name: case for file in cases_of(key) for name, case in loaded[file].items()}
            running.append(_begun(key, values[key], constants, numbers[key], cases, options.outer))
        if not running:
            break
        wait([each.pipe for each in running], timeout=5.0)
        for each in [each for each in running if _ended(each)]:
            running.remove(each)
            entries[each.key] = each.entry
            results.save(path, entries)
            done += 1
            took_min = (time.monotonic() - began) / 60.0
            print(f"{done} of {len(todo)}, {took_min:.1f} min: {each.key}", flush=True)
    results.save(path, entries)


def _begun(
    key: str, value: str, constants: Constants, number: int, cases: dict[str, _Loaded], outer: bool
) -> _Running:
    """Start the evaluations of one constant, in the cases that read it."""
    cases = {name: case for name, case in cases.items() if number in case.read | case.prepared}
    # Forked, so that data are loaded once, and an endless loop ends with its process.
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(theirs, constants, number, list(cases.values()), outer))
    process.start()
    theirs.close()
    return _Running(key, Entry(value, "", list(cases)), process, ours, time.monotonic())


def _ended(each: _Running) -> bool:
    """Take what has arrived; true when nothing more will."""
    ended = False
    while not ended and each.pipe.poll():
        try:
            message = each.pipe.recv()
        except EOFError:
            each.entry.results[f"{each.factor:g}"] = Result(1e3, True, [], "aborts")
            ended = True
            break
        if message[0] == "begun":
            each.factor = message[1]
        elif message[0] == "done":
            each.entry.results[f"{message[1]:g}"] = message[2]
        else:
            ended = True
    if not ended and time.monotonic() - each.began > _PATIENCE_S:
        each.process.kill()
        each.entry.results[f"{each.factor:g}"] = Result(1e3, True, [], "does not end")
        ended = True
    if ended:
        each.process.join()
    return ended

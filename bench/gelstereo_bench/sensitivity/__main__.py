"""`python -m gelstereo_bench.sensitivity`: see `--help`."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

from gelstereo_bench.sensitivity import page, results
from gelstereo_bench.sensitivity.instrument import build
from gelstereo_bench.sensitivity.source import sources

REPOSITORY = Path(__file__).resolve().parents[3]
CORE = REPOSITORY / "crates/gelstereo-core/src"
PAGE = REPOSITORY / "docs/constants.md"
RESULTS = Path(__file__).parent / "results.json"
SCRATCH = REPOSITORY / "target/sensitivity"

_EXAMPLES = """\
The sweep changes every constant that docs/constants.md lists by factors of 0.5, 0.8, 1.25 and 2, one at a
time, and evaluates its stage against ground truth. It takes about three quarters of an hour, may be stopped
at any time, and goes on with what is missing: constants that are new, or have another value than they were
swept with.

  python -m gelstereo_bench.sensitivity            sweep what is missing
  python -m gelstereo_bench.sensitivity --again 'detect/mask'   first forget what begins so
  python -m gelstereo_bench.sensitivity --prune    forget constants that are gone, also on the page
  python -m gelstereo_bench.sensitivity --page     write the column of docs/constants.md
"""


def _values() -> dict[str, str]:
    """Value in the source of every listed constant that is there, by key."""
    files = sources(CORE)
    out = {}
    for file, name in page.listed(PAGE):
        found = [each for each in files[file].definitions if each.name == name] if file in files else []
        if found:
            out[results.key_of(file, name)] = files[file].value(found[0])
    return out


def _built(values: dict[str, str]) -> dict[str, object]:
    """Build the scratch copy unless it is there for this source; return numbers, and what cannot be swept."""
    digest = hashlib.sha256(json.dumps(values).encode())
    for path in sorted(
        path
        for folder in ("crates", "firmware-host/src", "python")
        for path in (REPOSITORY / folder).rglob("*")
    ):
        if path.suffix in (".rs", ".toml", ".py"):
            digest.update(path.read_bytes())
    record = SCRATCH / "built.json"
    if record.exists():
        stored: dict[str, object] = json.loads(record.read_text(encoding="utf-8"))
        if stored["digest"] == digest.hexdigest():
            return stored
    record.unlink(missing_ok=True)
    keys = [(file, name) for file, _, name in (key.partition(": ") for key in values)]
    left = build(REPOSITORY, SCRATCH / "copy", SCRATCH / "build", keys)
    built: dict[str, object] = {
        "digest": digest.hexdigest(),
        "values": values,
        "numbers": {results.key_of(*key): number for number, key in enumerate(keys)},
        "left": {results.key_of(*key): reason for key, reason in left.items()},
    }
    record.write_text(json.dumps(built), encoding="utf-8")
    return built


def main() -> int:
    """Sweep, prune, or write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m gelstereo_bench.sensitivity",
        description=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--page", action="store_true", help="write docs/constants.md from the results")
    parser.add_argument("--prune", action="store_true", help="drop constants that the source no longer has")
    parser.add_argument("--again", metavar="START", help="sweep anew the constants whose file begins so")
    parser.add_argument("--jobs", type=int, default=2, help="processes; 2 without")
    parser.add_argument(
        "--only", metavar="START", default="", help="sweep only constants whose file begins so"
    )
    parser.add_argument("--outer", action="store_true", help="try 0.5 and 2 alone, to save time")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    values = _values()
    if options.measure:
        # Needs the scratch build in place of gelstereo.
        from gelstereo_bench.sensitivity.measure import Options, measure

        built = json.loads((SCRATCH / "built.json").read_text(encoding="utf-8"))
        measure(
            RESULTS,
            built["values"],
            built["numbers"],
            built["left"],
            Options(options.jobs, options.outer, options.only),
        )
        return 0
    entries = results.load(RESULTS)
    if options.prune:
        results.save(RESULTS, results.pruned(entries, values))
        page.write(PAGE, results.load(RESULTS), kept=set(values))
        return 0
    if options.page:
        page.write(PAGE, entries)
        return 0
    if options.again:
        results.save(
            RESULTS, {key: each for key, each in entries.items() if not key.startswith(options.again)}
        )
    _built(values)
    paths = [str(SCRATCH / "copy/python"), str(REPOSITORY / "bench")]
    # One thread for each process: evaluations are the same, and two of them run beside each other.
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {**os.environ, **threads, "PYTHONPATH": os.pathsep.join(paths)}
    words = [sys.executable, "-m", "gelstereo_bench.sensitivity", "--measure", "--jobs", str(options.jobs)]
    words += ["--only", options.only]
    words += ["--outer"] if options.outer else []
    return subprocess.run(words, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())

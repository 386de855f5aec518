"""`python -m gelstereo_bench.mutations`: see `--help`."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from gelstereo_bench.mutations.copy import Copy
from gelstereo_bench.mutations.mutant import Mutant, mutants

REPOSITORY = Path(__file__).resolve().parents[3]
PAGE = REPOSITORY / "docs/mutations.md"
RESULTS = Path(__file__).parent / "results.json"
_HEAD = "| file | fault | found by |\n|---|---|---|\n"
_HELP = """\
Builds the faults of mutants.json into a copy of the repository, all of them switched off, and runs the tests
with one switched on at a time: first those that should find it, then all Rust tests, all Python tests, and
the digests. What finds it counts only if it passes with the fault switched off. It may be stopped, and goes
on with what is missing.

  python -m gelstereo_bench.mutations build         copy and build
  python -m gelstereo_bench.mutations run           try the mutants that have no result
  python -m gelstereo_bench.mutations run NAME...   try these again
  python -m gelstereo_bench.mutations page          write the table of docs/mutations.md
"""


def _load() -> dict[str, Any]:
    return json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}


def _save(mutant: Mutant, found: list[str]) -> None:
    results = {**_load(), mutant.name: {"digest": mutant.digest, "found": found}}
    rows = [f"{json.dumps(name)}: {json.dumps(results[name])}" for name in sorted(results)]
    RESULTS.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")


def _write_page() -> None:
    """Replace the table of the page, which is its end."""
    text, results = PAGE.read_text(encoding="utf-8"), _load()
    rows = []
    for mutant in mutants():
        result = results.get(mutant.name, {})
        names = [name.rpartition("::")[2] for name in result.get("found", [])[1:3]]
        if mutant.equivalent:
            found = f"cannot be: {mutant.equivalent}"
        elif result.get("digest") != mutant.digest:
            found = "not tried yet"
        else:
            found = ", ".join(f"`{name}`" for name in names) or "nothing"
        rows.append(f"| `{mutant.file}` | {mutant.breaks} | {found} |\n")
    PAGE.write_text(text[: text.index(_HEAD)] + _HEAD + "".join(rows), encoding="utf-8")


def main() -> int:
    """Build, run, or write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m gelstereo_bench.mutations",
        description=_HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("action", choices=["build", "run", "page"])
    parser.add_argument("names", nargs="*", help="mutants; without, those that have no result")
    options = parser.parse_args()
    copy = Copy(REPOSITORY, REPOSITORY / "target/mutations")
    if options.action == "build":
        copy.build(mutants())
    elif options.action == "page":
        _write_page()
    else:
        for number, mutant in enumerate(mutants()):
            known = _load().get(mutant.name, {}).get("digest") == mutant.digest
            if mutant.name in options.names or not (options.names or known or mutant.equivalent):
                found = copy.found_by(mutant, number)
                print(f"{mutant.name}: {', '.join(found) or 'not found'}", flush=True)
                _save(mutant, found)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Runs every check in the VM and writes one line of JSON for each to a folder that the host reads."""

from __future__ import annotations

import json
import signal
import sys
import time
import traceback
from pathlib import Path
from types import FrameType

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from guest.checks import CHECKS, Check, load_all

OUT = Path("/out")


def outcome(check: Check) -> dict[str, object]:
    """Runs one check."""

    def too_long(_signal: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"the check took longer than {check.limit_s} s")

    signal.signal(signal.SIGALRM, too_long)
    signal.alarm(check.limit_s)
    start, error, figures = time.monotonic(), None, None
    try:
        figures = check.function()
    except Exception:
        error = traceback.format_exc()
    finally:
        signal.alarm(0)
    return {"check": check.name, "error": error, "figures": figures, "seconds": time.monotonic() - start}


def main(names: list[str]) -> None:
    """Runs the named checks, or all."""
    load_all()
    with (OUT / "results.jsonl").open("w", encoding="utf-8") as results:
        for check in [CHECKS[name] for name in names] if names else CHECKS.values():
            results.write(json.dumps(outcome(check)) + "\n")
            results.flush()


if __name__ == "__main__":
    main(sys.argv[1:])

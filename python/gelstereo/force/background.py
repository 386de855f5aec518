"""Long work of compiled libraries in a process of its own: they do not answer Ctrl-C, but a process can be
ended.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["in_background"]

T = TypeVar("T")
Progress = Callable[[int, int], None]

# Unlike one of multiprocessing, this process does not import the caller's main module.
_CHILD = "from gelstereo.force.background import serve; serve()"


def in_background(work: Callable[[Progress], T], progress: Progress | None = None) -> T:
    """Result of `work`, computed by another process.

    Parameters
    ----------
    work
        Called with a function of the steps done and their number. It, its result and its errors can be
        pickled.
    progress
        Called in this process with the same numbers.

    Raises
    ------
    ChildProcessError
        If the other process ends without a result.
    """
    if not sys.executable:  # Python within another program
        return work(progress or (lambda done, total: None))
    words = [sys.executable, "-c", _CHILD]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    # Of a session of its own, it does not get a terminal's Ctrl-C.
    child = subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, start_new_session=True
    )
    assert child.stdin is not None and child.stdout is not None
    try:
        with child.stdin, child.stdout:
            pickle.dump(work, child.stdin)
            child.stdin.flush()
            while (answer := pickle.load(child.stdout))[0] == "step":
                if progress is not None:
                    progress(*answer[1])
    except (EOFError, BrokenPipeError) as error:
        raise ChildProcessError(
            f"the process of the computation ended with code {child.wait()}; was there enough memory?"
        ) from error
    finally:
        child.kill()
        child.wait()
    if answer[0] == "error":
        raise answer[1]
    result: T = answer[1]
    return result


def serve() -> None:
    """The other process: what to do comes from standard input, and the answers go to standard output."""
    output = sys.stdout.buffer

    def send(kind: str, value: Any) -> None:
        pickle.dump((kind, value), output)
        output.flush()

    try:
        work = pickle.load(sys.stdin.buffer)
        send("result", work(lambda done, total: send("step", (done, total))))
    except BrokenPipeError:
        # Nobody waits any more; without this, Python would report it again at exit.
        os._exit(1)
    except Exception as error:
        send("error", error)

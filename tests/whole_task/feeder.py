"""Feeds a FIFO with the world's frame stream.

usage: python -m whole_task.feeder FIFO WORLD_ADDRESS
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

from whole_task.world import connect

path, address = sys.argv[1:]
with connect(address) as world, Path(path).open("wb", buffering=0) as fifo:
    # Pictures from before the host came are not asked for.
    world.settimeout(None)
    world.sendall(b'{"ask":"frames"}\n')
    # When the host does not listen any more, the feeder has done its work.
    with suppress(BrokenPipeError):
        while data := world.recv(1 << 20):
            fifo.write(data)

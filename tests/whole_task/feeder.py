"""Feeds a FIFO with the world's frame stream.

usage: python -m whole_task.feeder FIFO WORLD_ADDRESS
"""

from __future__ import annotations

import sys
from pathlib import Path

from whole_task.world import connect

path, address = sys.argv[1:]
with connect(address) as world, Path(path).open("wb", buffering=0) as fifo:
    # Pictures from before the host came are not asked for.
    world.settimeout(None)
    world.sendall(b'{"ask":"frames"}\n')
    try:
        while data := world.recv(1 << 20):
            fifo.write(data)
    except BrokenPipeError:
        sys.exit("the host does not listen any more")

"""A serial line between two pseudo-terminals that can lose, double, change, delay and split bytes."""

from __future__ import annotations

import contextlib
import os
import pty
import random
import select
import threading
import time
import tty
from dataclasses import dataclass


@dataclass
class Faults:
    """Probability of each fault, for each burst of bytes that the device sends."""

    drop: float = 0.0
    double: float = 0.0
    change: float = 0.0
    late_s: float = 0.0
    late: float = 0.0
    split: float = 0.0
    seed: int = 1


class Wire:
    """Opens both ends; ``host_port`` and ``device_port`` are their paths."""

    def __init__(self, faults: Faults | None = None) -> None:
        self.faults = faults or Faults()
        self.cut = False
        #: Each so-many-th reply of the device is lost; 0 loses none.
        self.lose_every = 0
        self._replies = 0
        self._random = random.Random(self.faults.seed)
        self._masters: list[int] = []
        self._slaves: list[int] = []
        for _ in range(2):
            master, slave = pty.openpty()
            tty.setraw(master)
            tty.setraw(slave)
            self._masters.append(master)
            self._slaves.append(slave)
        self.host_port, self.device_port = (os.ttyname(slave) for slave in self._slaves)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._pump, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(timeout=5)
        for descriptor in [*self._masters, *self._slaves]:
            with contextlib.suppress(OSError):
                os.close(descriptor)

    def _pump(self) -> None:
        host, device = self._masters
        while not self._stop.is_set():
            ready, _, _ = select.select([host, device], [], [], 0.05)
            for end in ready:
                burst = os.read(end, 4096)
                if self.cut:
                    continue
                if end == host:
                    os.write(device, burst)
                else:
                    self._deliver(burst)

    def _deliver(self, burst: bytes) -> None:
        """Sends what the device wrote to the host, with faults."""
        faults, chance, host = self.faults, self._random.random, self._masters[0]
        self._replies += 1
        if self.lose_every and self._replies % self.lose_every == 0:
            return
        if chance() < faults.drop:
            return
        if chance() < faults.change:
            at = self._random.randrange(len(burst))
            burst = burst[:at] + bytes([burst[at] ^ 0x41]) + burst[at + 1 :]
        if chance() < faults.late:
            time.sleep(faults.late_s)
        if chance() < faults.split and len(burst) > 1:
            at = self._random.randrange(1, len(burst))
            os.write(host, burst[:at])
            time.sleep(0.004)
            burst = burst[at:]
        os.write(host, burst)
        if chance() < faults.double:
            os.write(host, burst)

"""Readings of processes and of the kernel during a run of `adapt.py`."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from scripts.bench.child import kernel_count
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    from scripts.netns.simlink import Host
    from scripts.robot.run import Side

_DAEMONS = ("run", "relay", "peer")
_SOCKETS = Path("/proc/thread-self/net/sockstat")  # of this thread's namespace, which /proc/net is not


class Processors:
    """Measure the CPU time of a robot's processes and of the machine while its sources publish."""

    def __init__(self) -> None:
        self._readings: list[tuple[float, dict[str, float], tuple[float, float]]] = []

    def read(self, side: Side) -> None:
        """Note the CPU time that each process has used so far."""
        used = {}
        for name, process in side.processes.items():
            with suppress(psutil.Error):
                times = psutil.Process(process.pid).cpu_times()
                used[name] = times.user + times.system
        machine = psutil.cpu_times()
        self._readings.append((time.monotonic(), used, (sum(machine), machine.idle + machine.iowait)))

    def shares(self) -> dict[str, float]:
        """Return cores used between first and last reading, and the busy share of the whole machine (0..1)."""
        (began_s, before, (all_before, idle_before)), *_, (ended_s, after, (all_after, idle_after)) = self._readings
        cores = {name: (after[name] - before[name]) / (ended_s - began_s) for name in after if name in before}
        return {
            **{name: round(cores[name], 4) for name in _DAEMONS if name in cores},
            "sources": round(sum(value for name, value in cores.items() if name not in _DAEMONS), 4),
            "machine": round(1.0 - (idle_after - idle_before) / max(1e-9, all_after - all_before), 4),
        }


class Reassembly:
    """Count the datagrams that a receiving host's kernel cannot reassemble.

    A datagram with missing fragments keeps its memory for 30 s (ipfrag_time). Once such datagrams fill 4 MB
    (ipfrag_high_thresh), no fragmented sample arrives.
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        self._failed_before = self._failed()
        self._peak_bytes = 0

    def read(self) -> None:
        """Note the memory of incomplete datagrams."""
        sockets = inside(self._host.namespace, _SOCKETS.read_text)
        frag = next(line.split() for line in sockets.splitlines() if line.startswith("FRAG:"))
        self._peak_bytes = max(self._peak_bytes, int(frag[frag.index("memory") + 1]))

    def figures(self) -> dict[str, int]:
        """Return the number of incomplete datagrams, and their largest memory (bytes)."""
        return {"failed": self._failed() - self._failed_before, "peak_bytes": self._peak_bytes}

    def _failed(self) -> int:
        return kernel_count(self._host, "Ip", "ReasmFails")

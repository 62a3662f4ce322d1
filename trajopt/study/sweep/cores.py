"""Processors to which timed processes are pinned: one physical core each, one left to the system."""

import os
from pathlib import Path

from trajopt.errors import InputError

TOPOLOGY = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"


def physical_cores() -> tuple[int, ...]:
    """One logical processor of each physical core that this process may use."""
    if not hasattr(os, "sched_getaffinity"):
        return tuple(range(os.cpu_count() or 1))
    firsts: dict[str, int] = {}
    for processor in sorted(os.sched_getaffinity(0)):
        try:
            siblings = Path(TOPOLOGY.format(processor)).read_text(encoding="ascii").strip()
        except OSError:
            siblings = str(processor)
        firsts.setdefault(siblings, processor)
    return tuple(sorted(firsts.values()))


def cores_for(jobs: int) -> tuple[int, ...]:
    """A core for each of ``jobs`` timed processes: the last ones, because the first handles the interrupts.

    Raises InputError for more than all physical cores but one; one process is always allowed.
    """
    cores = physical_cores()
    most = max(1, len(cores) - 1)
    if not 1 <= jobs <= most:
        raise InputError(
            f"jobs is {jobs}", f"allowed: 1 to {most} here, the physical cores but one: timed runs share none"
        )
    return cores[-jobs:]

"""Results of the candidates of a task, stored in a folder as they finish."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trajopt.errors import InputError, expanded
from trajopt.motion.solution import Solution
from trajopt.schedule.schedule import Motion
from trajopt.study.discovery.modes import ModeSequence
from trajopt.study.discovery.task import ContactTask
from trajopt.study.records import JsonLines

RECORD = "discovery.jsonl"
# Screened: solved only on a coarse mesh. Untried: not solved at all.
PROPOSED, CERTIFIED, REJECTED = "proposed", "certified", "rejected"
SCREENED, UNTRIED = "screened", "untried"


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A schedule from its proposal to its result.

    Args:
        source: what proposed it.
        modes: its contacts and durations; None if the proposal failed.
        motion: from which a solve begins; it starts with the first of the modes.
        status: `PROPOSED` until it has a result.
        relaxed_objective: of the motion with relaxed contacts from which the modes were read.
        slack: of that motion.
        screened: objective with hard contacts on a coarse mesh.
        vanished: number of phases that shrank to nothing and were removed.
        objective: of the certified motion.
        why: reason for which it was rejected or not tried.
        seconds: of its solves.
        effort: of its solves: iterations times variables.
        solution: of a certified candidate.
    """

    source: str
    modes: ModeSequence | None = None
    motion: Motion | None = field(default=None, repr=False)
    status: str = PROPOSED
    relaxed_objective: float | None = None
    slack: float | None = None
    screened: float | None = None
    vanished: int = 0
    objective: float | None = None
    why: str = ""
    seconds: float = 0.0
    effort: float = 0.0
    solution: Solution | None = field(default=None, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able fields, without the motion and the solution."""
        modes, objects = self.modes, ("modes", "motion", "solution")
        return {name: value for name, value in vars(self).items() if name not in objects} | {
            "modes": modes and [[list(contacts), duration] for contacts, duration in modes.modes],
            "dropped": modes and modes.dropped,
            "unlifted": modes and modes.unlifted,
        }

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any], solution: Solution | None) -> Candidate:
        """The inverse of `to_dict`. Raises KeyError, TypeError or ValueError for anything else."""
        fields = dict(entry)
        modes = fields.pop("modes")
        counts = {name: fields.pop(name) or 0 for name in ("dropped", "unlifted")}
        read = modes and ModeSequence(tuple((tuple(names), float(time)) for names, time in modes), **counts)
        return cls(**fields, modes=read, solution=solution)


@dataclass(frozen=True, kw_only=True, eq=False)
class Discovery:
    """All candidates of a task, in the order in which they finished."""

    task: ContactTask
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> tuple[Candidate, ...]:
        """Certified candidates, lowest objective first."""
        held = [each for each in self.candidates if each.status == CERTIFIED]
        return tuple(sorted(held, key=lambda each: each.objective or 0.0))

    @property
    def seconds(self) -> float:
        """Solver time of all candidates, s."""
        return sum(each.seconds for each in self.candidates)

    @property
    def effort(self) -> float:
        """Effort of all solves: iterations times variables."""
        return sum(each.effort for each in self.candidates)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able task and candidates."""
        return {
            "task": self.task.describe(),
            "left_out": list(self.task.left_out),
            "candidates": [each.to_dict() for each in self.candidates],
        }


class DiscoveryRecords:
    """Collects candidates; a folder gets the task, a line per candidate, and the certified motions."""

    def __init__(self, task: ContactTask, folder: Path | str | None, *, resume: bool) -> None:
        self.candidates: list[Candidate] = []
        self.folder = None if folder is None else expanded(folder)
        path = None if self.folder is None else self.folder / RECORD
        if path is not None and not resume and path.exists() and path.stat().st_size:
            raise InputError(f"{self.folder} has candidates", "allowed: `resume`, or another folder")
        self._lines = JsonLines(path)
        head, words = {"task": task.describe()}, {"task": "another task, or other values"}
        for entry in self._lines.begin("discovery", head, words, resume=resume):
            with suppress(KeyError, TypeError, ValueError, InputError):  # incomplete entries are tried again
                held = entry["status"] == CERTIFIED
                solution = Solution.load(self._file(entry["source"])) if held else None
                candidate = Candidate.from_dict(entry, solution)
                if candidate.status != UNTRIED:
                    self.candidates.append(candidate)

    def _file(self, source: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{re.sub(r'[^A-Za-z0-9]+', '-', source)}.npz"

    def add(self, candidate: Candidate) -> None:
        """Store a candidate; its solution file is complete before its line is written."""
        self.candidates.append(candidate)
        if self.folder is not None and candidate.solution is not None:
            candidate.solution.save(self._file(candidate.source))
        self._lines.append(candidate.to_dict())

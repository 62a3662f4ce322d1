"""Contact modes: which contacts are on the ground when, read from the forces and heights of a motion."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from trajopt.schedule.gaits import support_names

# A contact is on the ground where its normal force exceeds this fraction of the weight.
LOADED = 0.06
# A contact that neither rises nor moves by more than this, in robot lengths, is not lifted.
LIFTED = 0.02
# Number of times at which sequences are compared.
SAMPLES = 100


@dataclass(frozen=True)
class ModeSequence:
    """Contacts and duration, s, of consecutive modes.

    Args:
        shift: s by which a cycle begins later than the motion from which it was read.
        dropped: number of modes removed because they are too short for the mesh.
        unlifted: number of swings removed because the contact was not lifted.
    """

    modes: tuple[tuple[tuple[str, ...], float], ...]
    shift: float = 0.0
    dropped: int = 0
    unlifted: int = 0

    @property
    def duration(self) -> float:
        """Total duration, s."""
        return sum(duration for _, duration in self.modes)

    @property
    def key(self) -> tuple[tuple[str, ...], ...]:
        """Contacts of each mode; equal for schedules that differ only in durations."""
        return tuple(contacts for contacts, _ in self.modes)

    def names(self) -> list[str]:
        """Names of the phases, by the number of feet on the ground: double_1, flight_1, double_2, ..."""
        return support_names(self.key)

    def duty(self) -> dict[str, float]:
        """Fraction of the duration for which each contact is on the ground, for those that ever are."""
        feet = dict.fromkeys(name for contacts in self.key for name in contacts)
        on = {foot: sum(time for contacts, time in self.modes if foot in contacts) for foot in feet}
        return {foot: time / self.duration for foot, time in on.items()}

    def apart(self, other: "ModeSequence") -> float:
        """Fraction of contact states, over time, that differ between two cycles at the best shift."""
        names = sorted({name for key in (*self.key, *other.key) for name in key})
        one, two = (each._active(names) for each in (self, other))
        return float(min((one != np.roll(two, shift, axis=1)).mean() for shift in range(SAMPLES)))

    def _active(self, names: Sequence[str]) -> np.ndarray:
        """Whether each contact is on the ground at equally spaced times (n, SAMPLES)."""
        ends = np.cumsum([duration for _, duration in self.modes]) / self.duration
        at = np.searchsorted(ends[:-1], (np.arange(SAMPLES) + 0.5) / SAMPLES)
        return np.array([[name in self.key[index] for index in at] for name in names])

    def source(self) -> str:
        """The schedule as Python source for a problem."""
        lines = ["from trajopt.schedule import Phase, Schedule", "", "SCHEDULE = Schedule(", "    ("]
        for name, (contacts, duration) in zip(self.names(), self.modes, strict=True):
            lines.append(f"        Phase(name={name!r}, duration={duration:.6g}, contacts={contacts!r}),")
        return "\n".join([*lines, "    )", ")", ""])

    def __str__(self) -> str:
        parts = ("+".join(contacts) or "flight" for contacts, _ in self.modes)
        return ", ".join(
            f"{part} {duration:.3g} s" for part, (_, duration) in zip(parts, self.modes, strict=True)
        )

    def from_touchdown(self) -> "ModeSequence":
        """The same cycle starting at a touchdown, if it has one."""
        for start in range(len(self.modes)):
            if set(self.modes[start][0]) - set(self.modes[start - 1][0]):
                begin = sum(duration for _, duration in self.modes[:start])
                turned = self.modes[start:] + self.modes[:start]
                return replace(self, modes=turned, shift=self.shift + begin)
        return self

    def neighbours(self, periodic: bool) -> Iterator[tuple[str, "ModeSequence"]]:
        """Yield named variants: with one mode removed, or with two successive contact changes swapped.

        The first mode is kept; so is the last one of a motion that is not a cycle.
        """
        count = len(self.modes)
        for k in range(1, count if periodic else count - 1):
            contacts, duration = self.modes[k]
            modes, halves = [*self.modes], (k - 1, k + 1) if k + 1 < count else (k - 1, k - 1)
            for i in halves:
                modes[i] = (modes[i][0], modes[i][1] + duration / 2)
            modes.pop(k)
            yield f"without-{k}", replace(self, modes=tuple(modes))._joined(periodic)
            before, after = (set(self.modes[i % count][0]) for i in (k - 1, k + 1))
            middle = before ^ after ^ set(contacts)
            if count > 2 and middle not in (set(contacts), before, after):
                names = dict.fromkeys(name for key in self.key for name in key)
                swapped = tuple(name for name in names if name in middle)
                modes = [*self.modes]
                modes[k] = (swapped, duration)
                yield f"swapped-{k}", replace(self, modes=tuple(modes))

    def without_short(self, least: float, periodic: bool) -> "ModeSequence":
        """Merge modes shorter than ``least`` s into the neighbours with the most similar contacts.

        The first and last modes of a motion that is not a cycle are kept.
        """
        modes, shift, dropped = [*self.modes], self.shift, self.dropped
        while True:
            inner = range(len(modes)) if periodic else range(1, len(modes) - 1)
            index = min(inner, key=lambda i: modes[i][1], default=0)
            contacts, duration = modes[index]
            if len(inner) < 1 or len(modes) < 2 or duration >= least:
                break
            dropped += 1
            near = [i % len(modes) for i in (index - 1, index + 1) if periodic or 0 <= i < len(modes)]
            changes = [len(set(modes[i][0]) ^ set(contacts)) for i in near]
            taking = {i for i, change in zip(near, changes, strict=True) if change == min(changes)}
            share = duration / len(taking)
            for i in taking:
                modes[i] = (modes[i][0], modes[i][1] + share)
            if index == 0 and len(modes) - 1 in taking:  # the last mode's share precedes the cycle
                shift += share
            modes.pop(index)
            joined = ModeSequence(tuple(modes), shift)._joined(periodic)
            modes, shift = [*joined.modes], joined.shift
        return replace(self, modes=tuple(modes), shift=shift, dropped=dropped)

    def _joined(self, periodic: bool) -> "ModeSequence":
        """Merge adjacent modes with the same contacts."""
        groups = [
            (contacts, sum(duration for _, duration in group))
            for contacts, group in groupby(self.modes, key=lambda mode: mode[0])
        ]
        shift = self.shift
        if periodic and len(groups) > 1 and groups[0][0] == groups[-1][0]:
            contacts, last = groups.pop()
            groups[0] = (contacts, groups[0][1] + last)
            shift -= last
        return replace(self, modes=tuple(groups), shift=shift)


def read_modes(
    contacts: Sequence[str],
    times: np.ndarray,
    duration: float,
    loaded: np.ndarray,
    gaps: np.ndarray,
    places: np.ndarray,
    *,
    length: float,
    cycle: np.ndarray | None = None,
    ends: tuple[Sequence[str], Sequence[str]] | None = None,
) -> ModeSequence:
    """Read the modes of a motion from n samples.

    Args:
        contacts: names (nc).
        times: (n,) s, ascending.
        duration: of the motion, s.
        loaded: (n, nc) whether each contact carries load.
        gaps: (n, nc) heights above the ground, m.
        places: (n, nc, 3) positions, m.
        length: of the robot, m.
        cycle: displacement (3,) per cycle, m; None for a motion that is not a cycle.
        ends: names of the contacts that stand at the start and at the end.
    """
    on, unlifted, n = loaded.copy(), 0, len(times)
    for column in range(len(contacts)):
        for rows in _runs(~on[:, column], cycle is not None):
            before, after = rows[0] - 1, rows[-1] + 1
            if cycle is None and (before < 0 or after >= n):
                continue
            moved = places[after % n, column] - places[before % n, column]
            if cycle is not None and (before < 0 or after % n <= before):
                moved = moved + cycle
            if max(gaps[rows, column].max(), float(np.linalg.norm(moved))) < LIFTED * length:
                on[rows, column], unlifted = True, unlifted + 1
    if ends is not None:
        for row, standing in zip((0, -1), ends, strict=True):
            on[row] = [name in standing for name in contacts]
    borders = np.concatenate([[0.0], (times[1:] + times[:-1]) / 2, [duration]])
    modes = tuple(
        (tuple(name for name, touches in zip(contacts, row, strict=True) if touches), float(width))
        for row, width in zip(on, np.diff(borders), strict=True)
    )
    return replace(ModeSequence(modes)._joined(cycle is not None), unlifted=unlifted)


def _runs(flags: np.ndarray, periodic: bool) -> list[list[int]]:
    """Indices of each run of true flags; in a cycle, a run may wrap around the end."""
    runs = [
        [index for index, _ in group]
        for flag, group in groupby(enumerate(flags.tolist()), key=lambda entry: entry[1])
        if flag
    ]
    if periodic and len(runs) > 1 and runs[0][0] == 0 and runs[-1][-1] == len(flags) - 1:
        runs[0] = runs.pop() + runs[0]
    return [] if flags.all() else runs

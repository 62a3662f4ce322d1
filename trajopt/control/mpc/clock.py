"""Clocks of contact modes, for gaits and finite motions: which contacts stand, now and next, and how long."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Self

from typing_extensions import override

from trajopt.control.mpc.commands import STAND
from trajopt.schedule.gaits import Gait

# Between two gaits and before the first swing the robot stands for this fraction of the longest period.
SETTLE = 0.3
# A mode is lengthened or shortened by at most this fraction of its duration.
MOST_STRETCH = 0.35
# Number of modes in which swings are searched: more than any horizon has, so that every swing's end is known.
SWING_MODES = 24


@dataclass(frozen=True)
class Mode:
    """Contacts that stand for a duration in s, which is infinite while the robot stands still."""

    contacts: tuple[str, ...]
    duration: float


@dataclass(frozen=True)
class Swing:
    """A swing of one contact from ``begin`` to ``end``, s from now; ``begin`` is negative if it has begun."""

    begin: float
    end: float


@dataclass(frozen=True)
class Stretch:
    """By how much the mode with this number should outlast its plan, s."""

    number: int
    wanted: float


class ModeClock:
    """Contact modes from now on: a queue, followed by a cycle that repeats for ever.

    Args:
        contacts: names of all feet.
        queue: modes from now on.
        cycle: modes that repeat after the queue.
        period: natural duration of a cycle, s; horizons are measured in it.

    ``number`` counts the modes from 0. If a mode ends early, a clock that ``keeps_time`` adds the remaining
    time to the next mode; other clocks advance all that follows.
    """

    keeps_time = False

    def __init__(
        self, contacts: Sequence[str], queue: Sequence[Mode], cycle: Sequence[Mode], period: float
    ) -> None:
        self.contacts, self._queue, self._cycle = tuple(contacts), list(queue), tuple(cycle)
        self.remaining, self._period, self._index = self._queue[0].duration, period, 0
        self._lifted = dict.fromkeys(self.contacts, 0.0)  # time that each has been in the air, s
        self.number, self._stretched = 0, 0.0

    def copy(self) -> Self:
        """An independent copy of the clock."""
        twin = copy.copy(self)
        twin._queue, twin._lifted = list(self._queue), dict(self._lifted)
        return twin

    @property
    def period(self) -> float:
        """Duration of a cycle, s."""
        return self._period

    @property
    def whole(self) -> float:
        """Whole duration of the present mode, s."""
        return self._queue[0].duration

    @property
    def state(self) -> tuple[object, ...]:
        """What determines the modes that may follow, apart from the remaining time of the present one."""
        return self._index, tuple(self._queue), math.isinf(self.remaining)

    def branches(self) -> list[Self]:
        """Clocks that may follow this one: at the end of the present mode, and at the start of the next."""
        late, after = self.copy(), self.copy()
        if math.isfinite(late.remaining):
            late.remaining = 0.0
        after.skip()
        return [late, after]

    def modes(self) -> Iterator[Mode]:
        """Modes from now on, the first with its remaining duration."""
        yield Mode(self._queue[0].contacts, self.remaining)
        yield from self._queue[1:]
        index = self._index
        while True:
            yield self._cycle[index]
            index = (index + 1) % len(self._cycle)

    def horizon(self, span: float) -> tuple[Mode, ...]:
        """Modes from now on, until those after the present mode last at least ``span`` s in total.

        A present mode that lasts longer than ``span`` is returned alone. Durations are cut to ``span``.
        """
        taken: list[Mode] = []
        total = 0.0
        for mode in self.modes():
            taken.append(Mode(mode.contacts, min(mode.duration, span)))
            total += mode.duration if len(taken) > 1 or mode.duration > span * (1 + 1e-9) else 0.0
            if total >= span * (1 - 1e-9):
                return tuple(taken)
        raise AssertionError("a clock has modes without end")

    def swings(self) -> dict[str, list[Swing]]:
        """Swings of every contact from now on, the present one first."""
        result: dict[str, list[Swing]] = {name: [] for name in self.contacts}
        begun = {name: -self._lifted[name] for name in self.contacts if name not in self._queue[0].contacts}
        time = 0.0
        for mode in islice(self.modes(), SWING_MODES):
            for name in self.contacts:
                if name in mode.contacts and name in begun:
                    result[name].append(Swing(begun.pop(name), time))
                elif name not in mode.contacts:
                    begun.setdefault(name, time)
            if math.isinf(mode.duration):
                return result
            time += mode.duration
        for name, begin in begun.items():
            result[name].append(Swing(begin, time))
        return result

    def landing(self) -> tuple[str, ...]:
        """Contacts that land at the end of the present mode."""
        following = next(islice(self.modes(), 1, None)).contacts
        return tuple(name for name in following if name not in self._queue[0].contacts)

    def advance(self, time: float, touching: Mapping[str, bool]) -> None:
        """Advance the clock by ``time`` s.

        The present mode ends early if all contacts that land at its end touch during its last third.
        """
        mode, landing = self._queue[0], self.landing()
        for name in self.contacts:
            self._lifted[name] = 0.0 if name in mode.contacts else self._lifted[name] + time
        if math.isinf(self.remaining):
            return
        self.remaining -= time
        down = all(touching[name] for name in landing)
        early = bool(landing) and down and self.remaining < mode.duration / 3
        if self.remaining <= 1e-9:
            self._next(self.remaining)
        elif early:
            self._next(self.remaining if self.keeps_time else 0.0)

    def stretch(self, by: Stretch, share: float) -> None:
        """Lengthen or shorten the present mode by a share of the change still wanted, within bounds."""
        if by.number != self.number or math.isinf(self.remaining):
            return
        most = MOST_STRETCH * self.whole
        wanted = min(max(by.wanted, -most), most)
        moved = max(min(share, 1.0) * (wanted - self._stretched), -max(self.remaining, 0.0))
        self.remaining, self._stretched = self.remaining + moved, self._stretched + moved

    def skip(self) -> None:
        """Go to the start of the next mode, unless the present one never ends."""
        if math.isfinite(self.remaining):
            self._next(0.0)

    def _next(self, left: float) -> None:
        """Go to the next mode and lengthen it by ``left`` s."""
        self.number, self._stretched = self.number + 1, 0.0
        self._queue.pop(0)
        if not self._queue:
            self._queue.append(self._cycle[self._index])
            self._index = (self._index + 1) % len(self._cycle)
        self.remaining = self._queue[0].duration + left


class GaitClock(ModeClock):
    """Modes of a commanded gait from now on; at first the robot stands.

    Args:
        contacts: names of all feet.
        gaits: gaits and their periods in s, by name.
    """

    def __init__(self, contacts: Sequence[str], gaits: Mapping[str, tuple[Gait, float]]) -> None:
        self.gaits, self.gait = dict(gaits), STAND
        stance = Mode(tuple(contacts), math.inf)
        super().__init__(contacts, (stance,), (stance,), min(period for _, period in self.gaits.values()))

    @property
    @override
    def period(self) -> float:
        """Period of the gait, s; of a stance, the shortest period of the gaits."""
        return self.gaits[self.gait][1] if self.gait in self.gaits else self._period

    @property
    @override
    def state(self) -> tuple[object, ...]:
        return self.gait, *super().state

    @override
    def branches(self) -> list[Self]:
        changed = []
        for gait in (STAND, *self.gaits):
            changed.append(self.copy())
            changed[-1].request(gait)
        return [*super().branches(), *changed]

    def request(self, gait: str) -> None:
        """Change to another gait or to a stance after the present mode."""
        if gait == self.gait:
            return
        standing = len(self._queue[0].contacts) == len(self.contacts)
        self.gait, self._index, self._queue = gait, 0, self._queue[:1]
        self._cycle = self.cycle_of(gait)
        settle = self._stance(SETTLE * max(period for _, period in self.gaits.values()))
        if gait == STAND and standing:
            self._queue, self.remaining = [self._stance(math.inf)], math.inf
        elif gait != STAND and math.isinf(self.remaining):
            self._queue, self.remaining = [settle], settle.duration
        elif gait != STAND and not standing:
            self._queue.append(settle)

    def cycle_of(self, gait: str) -> tuple[Mode, ...]:
        """Modes of one period of a gait, from the one with most contacts on; of a stance one endless mode."""
        if gait == STAND:
            return (self._stance(math.inf),)
        pattern, period = self.gaits[gait]
        modes = [Mode(phase.contacts, phase.duration) for phase in pattern.phases(period)]
        first = max(range(len(modes)), key=lambda i: len(modes[i].contacts))
        return (*modes[first:], *modes[:first])

    def _stance(self, duration: float) -> Mode:
        return Mode(self.contacts, duration)

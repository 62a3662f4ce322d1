"""Rolling soles: in every stance a foot stands on its heel first, then flat, then on its toe.

    heel     from the touchdown, for a part of the stance
    flat     heel and toe
    toe      to the lift-off, for a part of the stance

The contacts are those of `trajopt.robot.edges`: heel and toe each hold from their own touchdown to their own
lift-off. In human walking, with a stance of 62 % of the gait cycle, the foot is flat from 12 to 31 % of it
(mid stance; Perry, Burnfield, "Gait Analysis", 2nd ed. 2010).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.robot.edges import EDGES, Edge, edge_contacts
from trajopt.schedule.gaits import LEAST_SHARE, SIMULTANEOUS
from trajopt.schedule.schedule import Phase, Schedule

# Repetitions of a periodic schedule before and after it, so that stances across its ends are seen whole.
REPETITIONS = 2


@dataclass(frozen=True)
class _Roll:
    """A stance of a sole, times in s: touchdown, start of its flat part, rise of its heel, lift-off."""

    begin: float
    flat: float
    rising: float
    end: float

    def edges(self, time: float) -> tuple[Edge, ...]:
        """Edges on the ground at a time: heel, toe or both; none outside the stance."""
        if not self.begin < time < self.end:
            return ()
        return EDGES[:1] if time < self.flat else EDGES[1:] if time > self.rising else EDGES


@checked
def rolled(
    schedule: Schedule,
    soles: Sequence[str],
    *,
    heel: float,
    toe: float,
    next_name: Mapping[str, str] | None = None,
) -> Schedule:
    """The schedule in which soles roll over their heels and toes, for `trajopt.robot.with_edges`.

    Phases are split where a sole becomes flat or its heel rises. They keep their names, with a letter
    appended if a phase has several parts. A sole that stands at the start or at the end of the schedule is
    flat there; parts of such a stance refer to its time within the schedule.

    Args:
        schedule: schedule with soles.
        soles: names of those that roll.
        heel: part of each stance on the heel, at least 0.
        toe: part of each stance on the toe, at least 0.
        next_name: for a periodic schedule, the contact whose motion each sole continues after the end, as in
            `trajopt.terms.swing_arcs`. Stances then continue from the end to the beginning.

    Raises:
        InputError: for parts that leave no flat sole, soles of which none is active, a sole with a foothold,
            and phases that are cut too short.
    """
    if not (heel >= 0 and toe >= 0 and heel + toe < 1):
        raise InputError(
            f"parts of a stance on heel and toe are {heel:g} and {toe:g}",
            "allowed: 0 or more, together less than 1, so that the sole is flat in between",
        )
    for phase in schedule.phases:
        for name in set(soles) & set(phase.footholds):
            what = f"sole '{name}' that rolls has a foothold in phase '{phase.name}'"
            raise InputError(what, "allowed: soles that land anywhere")
    if not any(name in phase.contacts for phase in schedule.phases for name in soles):
        raise InputError(f"soles {', '.join(soles) or 'none'} are in no phase", "allowed: active contacts")
    rolls = {name: _rolls(schedule, name, heel, toe, next_name) for name in soles}
    parts, begin = [], 0.0
    for index, phase in enumerate(schedule.phases):
        end = begin + phase.duration
        times = {time for each in rolls.values() for roll in each for time in (roll.flat, roll.rising)}
        cuts = _cuts(phase.name, begin, end, times)
        for number, (first, last) in enumerate(pairwise(cuts)):
            middle = (first + last) / 2
            corners = {name: _standing(name, each, middle) for name, each in rolls.items()}
            part = _part(schedule, index, corners, (last - first) / phase.duration)
            letter = chr(ord("a") + number) if len(cuts) > 2 else ""
            parts.append(replace(part, name=phase.name + letter, impact=phase.impact and number == 0))
        begin = end
    return Schedule(tuple(parts))


def _rolls(
    schedule: Schedule, sole: str, heel: float, toe: float, next_name: Mapping[str, str] | None
) -> list[_Roll]:
    """Every stance of a sole."""
    whole, repetitions, names = schedule.duration, 0, {0: sole}
    if next_name is not None:
        repetitions, before = REPETITIONS, {after: name for name, after in next_name.items()}
        for k in range(repetitions):
            names[k + 1], names[-k - 1] = next_name[names[k]], before[names[-k]]
    flags, time = [], -repetitions * whole
    for k in range(-repetitions, repetitions + 1):
        for phase in schedule.phases:
            flags.append((names[k] in phase.contacts, time, time + phase.duration))
            time += phase.duration
    stances = [list(run) for stands, run in groupby(flags, lambda flag: flag[0]) if stands]
    rolls = []
    for run in stances:
        (_, begin, _), (_, _, end) = run[0], run[-1]
        lands, lifts = run[0] is not flags[0], run[-1] is not flags[-1]
        rolls.append(
            _Roll(
                begin=begin if lands else -math.inf,
                flat=begin + heel * (end - begin) if lands else -math.inf,
                rising=end - toe * (end - begin) if lifts else math.inf,
                end=end if lifts else math.inf,
            )
        )
    return rolls


def _cuts(phase: str, begin: float, end: float, times: set[float]) -> list[float]:
    """Start and end of a phase, and the times within it; raises `InputError` for parts that are too short."""
    cuts, rounding = [begin], SIMULTANEOUS * max(abs(begin), end)
    for time in sorted(times):
        if cuts[-1] + rounding < time < end - rounding:
            cuts.append(time)
    cuts.append(end)
    shortest, allowed = (
        min(after - before for before, after in pairwise(cuts)),
        LEAST_SHARE * (end - begin),
    )
    if shortest < allowed:
        raise InputError(
            f"soles that roll cut {shortest:.2g} s off phase '{phase}'",
            f"allowed: at least {allowed:.2g} s; other parts of the stance on heel or toe",
        )
    return cuts


def _standing(sole: str, rolls: list[_Roll], time: float) -> tuple[str, ...]:
    """Corners of a sole that are on the ground at a time."""
    return tuple(name for roll in rolls for edge in roll.edges(time) for name in edge_contacts(sole, edge))


def _part(schedule: Schedule, index: int, corners: Mapping[str, tuple[str, ...]], share: float) -> Phase:
    """A share of a phase, with soles replaced by these corners on the same ground."""
    phase, bounds = schedule.phases[index], schedule.phases[index].duration_bounds
    of = {name: corners.get(name, (name,)) for name in phase.contacts}
    patches = dict(phase.patches) | {name: schedule.patch(index, name) for name in of if name in corners}
    return replace(
        phase,
        duration=share * phase.duration,
        duration_bounds=None if bounds is None else (share * bounds[0], share * bounds[1]),
        contacts=tuple(corner for name in phase.contacts for corner in of[name]),
        surfaces={corner: surface for name, surface in phase.surfaces.items() for corner in of[name]},
        patches={corner: patch for name, patch in patches.items() if patch for corner in of[name]},
    )

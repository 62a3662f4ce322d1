"""Schedules that begin or end a gait: standing, some cycles, standing.

In a gait that starts from standing, each foot stands until its first swing. In one that stops, each foot
stays where it lands last.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

from trajopt.arguments import Positive, PositiveCount, checked
from trajopt.errors import InputError
from trajopt.schedule.gaits import LEAST_SHARE, SIMULTANEOUS, Gait, SupportPhase, phases_of
from trajopt.schedule.schedule import Phase


@dataclass(frozen=True)
class _Stances:
    """Touchdown and lift-off of every stance of one foot, in periods from the start of the first cycle."""

    foot: str
    times: tuple[tuple[float, float], ...]

    def stands(self, time: float) -> bool:
        return any(begin < time < end for begin, end in self.times)


@checked
def transition(
    gait: Gait,
    period: Positive,
    *,
    cycles: PositiveCount,
    stand: float | None = None,
    rest: float | None = None,
    start: str | None = None,
) -> tuple[Phase, ...]:
    """Phases of some periods of a gait that begin with standing, end with standing, or both.

    These stances are named "stand" and "rest", the other phases as in `Gait.phases`.

    Args:
        gait: the gait.
        period: duration of a period, s.
        cycles: number of periods.
        stand: duration of standing on all feet before the first is lifted, s; None begins within the gait, at
            a touchdown.
        rest: duration of standing after the last foot has landed, s; None ends at the touchdown that ends a
            period.
        start: foot whose touchdown begins the period, see `Gait.supports`.

    Raises:
        InputError: for numbers out of range, or feet that are never lifted.
    """
    for what, time in (("stand", stand), ("rest", rest)):
        if time is not None and not (math.isfinite(time) and time >= LEAST_SHARE * period):
            raise InputError(f"{what} is {time:g} s", f"allowed: at least {LEAST_SHARE * period:g} s")
    origin = gait.offsets[gait.first(start)]
    stances = [_stances(gait, foot, origin, cycles) for foot in gait.feet]
    begin, end = 0.0, float(cycles)
    if stand is not None:
        stances, begin = _from_standing(stances)
    if rest is not None:
        stances, end = _to_standing(stances, float(cycles))
    for each in stances:
        if each.times == ((-math.inf, math.inf),) and gait.duty_of(each.foot) < 1:
            raise InputError(
                f"{cycles} cycles of gait '{gait.name}' never lift '{each.foot}'", "allowed: more cycles"
            )
    window = (
        begin - (0.0 if stand is None else stand / period),
        end + (0.0 if rest is None else rest / period),
    )
    supports = _supports(stances, window)
    ends = [(0, "stand")] * (stand is not None) + [(len(supports) - 1, "rest")] * (rest is not None)
    moving = supports[stand is not None : len(supports) - (rest is not None)]
    phases = list(phases_of(moving, period, None))
    for index, name in ends:
        standing = phases_of([supports[index]], period, None)[0]
        phases.insert(index, replace(standing, name=name))
    return tuple(phases)


def _stances(gait: Gait, foot: str, origin: float, cycles: int) -> _Stances:
    if gait.duty_of(foot) == 1:
        return _Stances(foot, ((-math.inf, math.inf),))
    shift = (gait.offsets[foot] - origin + SIMULTANEOUS) % 1.0 - SIMULTANEOUS
    touchdowns = [shift + k for k in range(-1, cycles + 1)]
    return _Stances(foot, tuple((time, time + gait.duty_of(foot)) for time in touchdowns))


def _from_standing(stances: list[_Stances]) -> tuple[list[_Stances], float]:
    """Stances in which each foot stands until its first lift-off after time 0, and the earliest such time."""
    standing, first = [], math.inf
    for each in stances:
        later = [times for times in each.times if times[1] > -SIMULTANEOUS]
        standing.append(_Stances(each.foot, ((-math.inf, later[0][1]), *later[1:])))
        first = min(first, later[0][1])
    return standing, first


def _to_standing(stances: list[_Stances], end: float) -> tuple[list[_Stances], float]:
    """Stances in which each foot stands after its last touchdown before ``end``, and the latest such time."""
    standing, last = [], -math.inf
    for each in stances:
        earlier = [times for times in each.times if times[0] < end + SIMULTANEOUS]
        standing.append(_Stances(each.foot, (*earlier[:-1], (earlier[-1][0], math.inf))))
        last = max(last, earlier[-1][0])
    return standing, last


def _supports(stances: list[_Stances], window: tuple[float, float]) -> list[SupportPhase]:
    """Supports within a window of time, in periods."""
    inside = sorted(
        time
        for each in stances
        for stance in each.times
        for time in stance
        if window[0] + SIMULTANEOUS < time < window[1] - SIMULTANEOUS
    )
    merged = [window[0]]
    for time in (*inside, window[1]):
        if time - merged[-1] > SIMULTANEOUS:
            merged.append(time)
    supports = []
    for now, then in pairwise(merged):
        feet = tuple(each.foot for each in stances if each.stands((now + then) / 2))
        supports.append(SupportPhase(now, then - now, feet))
    return supports

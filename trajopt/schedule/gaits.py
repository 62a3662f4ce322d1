"""Gaits: which feet are on the ground when, from duty factors and phase offsets, for any set of feet.

A gait is periodic. A foot's *duty factor* is the fraction of the period in which it stands, its *offset* the
time of its touchdown as a fraction of the period (Alexander, "The gaits of bipedal and quadrupedal animals",
Int. J. Robotics Research 3, 1984; Hildebrand, "The quadrupedal gaits of vertebrates", BioScience 39, 1989).
Simultaneous events of two feet are one event; between events lie the phases of a schedule.

Offsets of the named gaits are their definitions: Hildebrand, "Symmetrical gaits of horses", Science 150
(1965), and "Analysis of asymmetrical gaits", J. Mammalogy 58 (1977). Animals vary their duty factors with
speed, above 1/2 in walks and below in runs. Those here are round values in the middle of their ranges;
`Gait.with_duty` changes them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType

from trajopt.arguments import Positive, PositiveCount, checked
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.errors import InputError, not_among
from trajopt.robot.legs import biped_legs, feet_by_side, feet_in_base, quadruped_legs
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase

# Events closer than this fraction of the period are one event: rounding of sums of decimal fractions.
SIMULTANEOUS = 1e-9
# A support shorter than this fraction of the period is rejected: either two events are meant to be one, or a
# duty factor is wrong. For a period of 0.1 s it is 1 ms, less than the step of any grid.
LEAST_SHARE = 0.01
# Strides of symmetrical gaits, see `stride_period`.
STRIDE, GROWTH, SLOWEST = 2.4, 0.34, 0.06
# Names of supports by the number of feet on the ground.
SUPPORTS = ("flight", "single", "double", "triple", "quadruple")


@dataclass(frozen=True)
class SupportPhase:
    """A part of a gait's period with a constant set of feet on the ground; all in fractions of the period."""

    begin: float
    part: float
    feet: tuple[str, ...]


@checked
@dataclass(frozen=True, kw_only=True)
class Gait:
    """A periodic pattern of stances.

    Args:
        name: name of the gait.
        duty: stance of every foot as a fraction of the period, one number for all or one per foot; a foot
            with 1 is never lifted.
        offsets: touchdown of every foot as a fraction of the period, taken modulo 1.

    Raises:
        InputError: for duty factors out of range, or feet other than those of the offsets.
    """

    name: str
    duty: Mapping[str, float] | float
    offsets: Mapping[str, float]

    def __post_init__(self) -> None:
        if not self.offsets:
            raise InputError(f"gait '{self.name}' has no feet", "allowed: an offset for each foot")
        given = self.duty if isinstance(self.duty, Mapping) else dict.fromkeys(self.offsets, self.duty)
        if set(given) != set(self.offsets):
            raise InputError(
                f"gait '{self.name}' has duty factors for {', '.join(given)}",
                f"allowed: one number, or one for each of {', '.join(self.offsets)}",
            )
        duty = {name: float(given[name]) for name in self.offsets}
        offsets = {name: float(value) % 1.0 for name, value in self.offsets.items()}
        for name, value in duty.items():
            if not (LEAST_SHARE <= value <= 1 - LEAST_SHARE or value == 1):
                raise InputError(
                    f"duty factor of '{name}' is {value:g}",
                    f"allowed: {LEAST_SHARE:g} to {1 - LEAST_SHARE:g}, or 1 for a foot that is never lifted",
                )
        if all(value == 1 for value in duty.values()):
            raise InputError(f"gait '{self.name}' lifts no foot", "allowed: a duty factor below 1")
        object.__setattr__(self, "duty", MappingProxyType(duty))
        object.__setattr__(self, "offsets", MappingProxyType(offsets))

    @property
    def feet(self) -> tuple[str, ...]:
        """Names of the feet."""
        return tuple(self.offsets)

    def duty_of(self, foot: str) -> float:
        """Duty factor of one foot."""
        assert isinstance(self.duty, Mapping)
        return self.duty[foot]

    def on(self, names: Mapping[str, str]) -> Gait:
        """This gait on other feet: ``names`` maps each of its feet to the name of a contact."""
        unknown = set(self.feet) - set(names)
        if unknown or len({names[foot] for foot in self.feet}) < len(self.feet):
            raise InputError(
                f"gait '{self.name}' has feet {', '.join(self.feet)}, names are {dict(names)}",
                "allowed: a different name for each foot",
            )
        return replace(
            self,
            duty={names[foot]: self.duty_of(foot) for foot in self.feet},
            offsets={names[foot]: self.offsets[foot] for foot in self.feet},
        )

    @checked
    def with_duty(self, duty: Mapping[str, float] | float) -> Gait:
        """This gait with other duty factors, one for all or one per foot."""
        return replace(self, duty=duty)

    def stands(self, foot: str, fraction: float) -> bool:
        """Whether the foot is on the ground at a fraction of the period; at lift-off it is in the air."""
        since = (fraction - self.offsets[foot] + SIMULTANEOUS) % 1.0
        return self.duty_of(foot) == 1 or since < self.duty_of(foot)

    def supports(self, start: str | None = None) -> tuple[SupportPhase, ...]:
        """The supports of one period, starting at a touchdown.

        Args:
            start: foot whose touchdown begins the period; default the one with the least offset among those
                that are lifted.

        Raises:
            InputError: for supports that are too short, or a foot that is never lifted.
        """
        begin = self.offsets[self.first(start)]
        events = self._events(begin)
        supports = []
        for now, then in zip(events, [*events[1:], 1.0], strict=True):
            middle = begin + (now + then) / 2
            feet = tuple(foot for foot in self.feet if self.stands(foot, middle))
            if then - now < LEAST_SHARE:
                raise InputError(
                    f"gait '{self.name}' has a support of {then - now:.2g} of its period",
                    f"allowed: at least {LEAST_SHARE:g}",
                )
            supports.append(SupportPhase(now, then - now, feet))
        return tuple(supports)

    def first(self, start: str | None = None) -> str:
        """The foot whose touchdown begins the period: ``start``, or the default of `supports`."""
        lifted = [foot for foot in self.feet if self.duty_of(foot) < 1]
        if start is None:
            return min(lifted, key=lambda foot: self.offsets[foot])
        if start not in lifted:
            raise InputError(
                f"gait '{self.name}' cannot begin with '{start}'", f"allowed: {', '.join(lifted)}"
            )
        return start

    def _events(self, begin: float) -> list[float]:
        """Times of touchdowns and lift-offs after ``begin``, fractions of the period, each once, 0 first."""
        times = [0.0]
        for foot in self.feet:
            if self.duty_of(foot) < 1:
                times += [self.offsets[foot] - begin, self.offsets[foot] + self.duty_of(foot) - begin]
        wrapped = sorted((time + SIMULTANEOUS / 2) % 1.0 - SIMULTANEOUS / 2 for time in times)
        return [0.0] + [b for a, b in pairwise(wrapped) if b - a > SIMULTANEOUS]

    def is_symmetric(self, mirror: Mapping[str, str]) -> bool:
        """Whether left and right move alike, half a period apart; ``mirror`` gives each foot's opposite."""
        return all(
            abs(self.duty_of(foot) - self.duty_of(mirror[foot])) < SIMULTANEOUS
            and abs(math.remainder(self.offsets[foot] + 0.5 - self.offsets[mirror[foot]], 1.0)) < SIMULTANEOUS
            for foot in self.feet
        )

    @checked
    def phases(
        self,
        period: Positive,
        *,
        cycles: PositiveCount = 1,
        start: str | None = None,
        duration_bounds: tuple[float, float] | None = None,
    ) -> tuple[Phase, ...]:
        """Phases of some periods, starting at a touchdown.

        Names number the supports of each kind: double_1, flight_1, double_2, ...

        Args:
            period: duration of a period, s.
            cycles: number of periods.
            start: foot whose touchdown begins the schedule, see `supports`.
            duration_bounds: (lower, upper) of free phase durations, as fractions of the nominal ones.

        Raises:
            InputError: for numbers out of range, or a foot that is never lifted.
        """
        return phases_of(self.supports(start) * cycles, period, duration_bounds)

    @checked
    def half_cycle(
        self,
        period: Positive,
        mirror: Mapping[str, str],
        *,
        start: str | None = None,
        duration_bounds: tuple[float, float] | None = None,
    ) -> tuple[Phase, ...]:
        """Phases of the first half of a period; the other half is their mirror image.

        Args:
            period: duration of a period, s.
            mirror: the foot on the other side, for every foot.
            start: foot whose touchdown begins the schedule, see `supports`.
            duration_bounds: (lower, upper) of free phase durations, as fractions of the nominal ones.

        Raises:
            InputError: for a gait that is not symmetric.
        """
        if not set(self.feet) <= set(mirror) or not self.is_symmetric(mirror):
            raise InputError(
                f"gait '{self.name}' is not its own mirror image half a period later",
                "allowed: a symmetric gait, or the full cycle",
            )
        supports = [support for support in self.supports(start) if support.begin < 0.5 - SIMULTANEOUS]
        return phases_of(supports, period, duration_bounds)


def phases_of(
    supports: Iterable[SupportPhase], period: float, bounds: tuple[float, float] | None
) -> tuple[Phase, ...]:
    """Phases of consecutive supports; their durations are free within ``bounds``, fractions of the nominal.

    ``period`` is in s. Raises `InputError` for bounds that do not enclose 1.
    """
    lower, upper = (1.0, 1.0) if bounds is None else bounds
    if not 0 < lower <= 1 <= upper < math.inf:
        raise InputError(
            f"durations are free between {lower:g} and {upper:g} of the nominal ones",
            "allowed: 0 < lower <= 1 <= upper",
        )
    phases = []
    supports = tuple(supports)
    for name, support in zip(support_names([each.feet for each in supports]), supports, strict=True):
        duration = support.part * period
        phases.append(
            Phase(
                name=name,
                duration=duration,
                contacts=support.feet,
                duration_bounds=None if bounds is None else (lower * duration, upper * duration),
            )
        )
    return tuple(phases)


def support_names(contacts: Iterable[Collection[str]]) -> list[str]:
    """Names of phases by their numbers of contacts: double_1, flight_1, double_2, ..."""
    counts: Counter[str] = Counter()
    names = []
    for feet in map(len, contacts):
        kind = SUPPORTS[feet] if feet < len(SUPPORTS) else f"support{feet}"
        counts[kind] += 1
        names.append(f"{kind}_{counts[kind]}")
    return names


@checked
def stride_period(
    robot: Robot, speed: float, *, stride: float = STRIDE, growth: float = GROWTH, slowest: float = SLOWEST
) -> float:
    """Duration in s of a stride of ``stride`` Fr^``growth`` lengths at ``speed`` m/s.

    Fr = speed^2 / (g l) is the Froude number. It is at least ``slowest``, so slower gaits all have the same
    period (Alexander, Jayes, "A dynamic similarity hypothesis for the gaits of quadrupedal mammals", J. Zool.
    201, 1983).
    """
    unit = math.sqrt(gravity_of(robot.model) * robot.length)
    root = max(abs(speed) / unit, math.sqrt(slowest))
    return stride * root ** (2 * growth - 1) * robot.length / unit


def _quadruped(name: str, duty: float, hind: tuple[float, float], front: tuple[float, float]) -> Gait:
    """A quadruped's gait; ``hind`` and ``front`` are the offsets of the left and the right foot."""
    feet = ("front_left", "front_right", "hind_left", "hind_right")
    return Gait(name=name, duty=duty, offsets=dict(zip(feet, (*front, *hind), strict=True)))


def _by_name(*gaits: Gait) -> Mapping[str, Gait]:
    return MappingProxyType({gait.name: gait for gait in gaits})


QUADRUPED = _by_name(
    # Symmetrical: left and right half a period apart, the fore foot lags the hind foot of its side.
    _quadruped("walk", 0.65, hind=(0.0, 0.5), front=(0.25, 0.75)),  # lateral sequence, three or two feet
    _quadruped("amble", 0.4, hind=(0.0, 0.5), front=(0.25, 0.75)),  # footfalls of the walk, as a run
    _quadruped("trot", 0.5, hind=(0.0, 0.5), front=(0.5, 0.0)),  # diagonal pairs
    _quadruped("flying-trot", 0.4, hind=(0.0, 0.5), front=(0.5, 0.0)),
    _quadruped("pace", 0.5, hind=(0.0, 0.5), front=(0.0, 0.5)),  # lateral pairs
    # Asymmetrical: both hind feet, then both fore feet.
    _quadruped("bound", 0.4, hind=(0.0, 0.0), front=(0.5, 0.5)),
    _quadruped("pronk", 0.6, hind=(0.0, 0.0), front=(0.0, 0.0)),
    _quadruped("gallop", 0.3, hind=(0.0, 0.1), front=(0.5, 0.6)),  # transverse: fore feet as the hind feet
    _quadruped("rotary-gallop", 0.3, hind=(0.0, 0.1), front=(0.6, 0.5)),  # footfalls go around the body
    _quadruped("canter", 0.4, hind=(0.25, 0.0), front=(0.5, 0.25)),  # three beats, left lead
)

BIPED = _by_name(
    Gait(name="walk", duty=0.6, offsets={"left": 0.0, "right": 0.5}),
    Gait(name="run", duty=0.35, offsets={"left": 0.0, "right": 0.5}),
)

HOPPER = _by_name(Gait(name="hop", duty=0.5, offsets={"foot": 0.0}))


def _waves(left: Sequence[str], right: Sequence[str]) -> Mapping[str, Gait]:
    """Gaits of three, five or more feet, given from hind to front: waves from hind to front on each side.

    With k of n feet in the air, the duty factor is 1 - k/n, and each foot of a side lags the one behind it by
    a swing, k/n. The right side lags by half a period, of a wave by all swings of the left. With four feet
    these are the footfalls of walk and trot (Wilson, "Insect walking", Annual Review of Entomology 11, 1966).
    """
    n = len(left) + len(right)
    swinging = {"tripod" if n == 6 else "alternating": n / 2, "ripple": 2.0, "wave": 1.0}
    gaits = []
    if n < 5:  # two of three in the air leave one
        swinging = {"wave": 1.0}
        gaits.append(Gait(name="pronk", duty=0.6, offsets=dict.fromkeys((*left, *right), 0.0)))
    for name, count in swinging.items():
        lag, half = count / n, len(left) / n if count == 1 else 0.5
        offsets = {foot: lag * i for i, foot in enumerate(left)}
        offsets |= {foot: half + lag * i for i, foot in enumerate(right)}
        gaits.append(Gait(name=name, duty=1 - lag, offsets=offsets))
    return _by_name(*gaits)


@checked
def gait_names(robot: Robot) -> tuple[str, ...]:
    """Names of the gaits for a robot's number of feet. Raises `InputError` for a robot without feet."""
    return tuple(_gaits(robot))


def _gaits(robot: Robot) -> Mapping[str, Gait]:
    """Gaits on the feet of a robot, by name."""
    feet = tuple(feet_in_base(robot))
    known = {4: QUADRUPED, 2: BIPED, 1: HOPPER}.get(len(feet))
    if known is None:
        return _waves(*feet_by_side(robot))
    names: Mapping[str, str] = {"foot": feet[0]}
    if known is QUADRUPED:
        names = quadruped_legs(robot).by_role
    elif known is BIPED:
        names = dict(zip(("left", "right"), biped_legs(robot), strict=True))
    return {name: gait.on(names) for name, gait in known.items()}


@checked
def gait_of(robot: Robot, name: str) -> Gait:
    """The gait of that name on the feet of a robot.

    Raises `InputError` for a robot without feet, or a name that is not a gait for its number of feet.
    """
    known = _gaits(robot)
    if name not in known:
        raise not_among(known, name, f"gait '{name}' is unknown")
    return known[name]

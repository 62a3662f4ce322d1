"""Contact-mode schedules: who is in contact, and for how long."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from trajopt.errors import InputError
from trajopt.surface import SAME_PLANE, UP, Surface


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A stretch of motion with a constant set of active contacts.

    ``duration`` in s; ``contacts`` are names of the robot's contacts; ``footholds`` optionally gives
    the world position (3,) in m at which a contact that begins with this phase must land (without
    it the contact only has to touch the terrain). ``duration_bounds`` (lower, upper) in s makes the
    duration free; ``duration`` is then its guess. ``impact``: contacts that begin with the phase land
    by a rigid impact, in which velocities jump, instead of at zero velocity. ``surfaces`` are what active
    contacts touch instead of the problem's terrain: a wall, a step, a handrail.
    """

    name: str
    duration: float
    contacts: tuple[str, ...] = ()
    footholds: Mapping[str, np.ndarray] = field(default_factory=dict)
    duration_bounds: tuple[float, float] | None = None
    impact: bool = False
    surfaces: Mapping[str, Surface] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.duration) and self.duration > 0):
            raise InputError(
                f"duration of phase '{self.name}' is {self.duration:g} s", "allowed: finite and > 0"
            )
        if not isinstance(self.impact, bool):
            raise InputError(f"impact of phase '{self.name}' is {self.impact!r}", "allowed: True or False")
        if self.duration_bounds is not None:
            self._require_bounds(self.duration_bounds)
        if len(set(self.contacts)) != len(self.contacts):
            raise InputError(f"phase '{self.name}' names a contact twice: {', '.join(self.contacts)}")
        self._require_active("foothold", self.footholds)
        self._require_active("surface", self.surfaces)
        for name, surface in self.surfaces.items():
            if not isinstance(surface, Surface):
                raise InputError(
                    f"surface of '{name}' in phase '{self.name}' is {surface!r}", "allowed: a Surface"
                )
        points = {name: np.array(point, dtype=float) for name, point in self.footholds.items()}
        for name, point in points.items():
            if point.shape != (3,) or not np.all(np.isfinite(point)):
                raise InputError(
                    f"foothold of '{name}' in phase '{self.name}' is {point}", "allowed: 3 finite numbers, m"
                )
            point.setflags(write=False)
            self._require_on_surface(name, point)
        object.__setattr__(self, "contacts", tuple(self.contacts))
        object.__setattr__(self, "footholds", MappingProxyType(points))
        object.__setattr__(self, "surfaces", MappingProxyType(dict(self.surfaces)))

    def _require_active(self, what: str, given: Mapping[str, object]) -> None:
        unknown = set(given) - set(self.contacts)
        if unknown:
            raise InputError(
                f"phase '{self.name}' has a {what} for {', '.join(sorted(unknown))}",
                "allowed: contacts that are active in the phase",
            )

    def _require_on_surface(self, name: str, foothold: np.ndarray) -> None:
        surface = self.surfaces.get(name)
        if surface is not None and abs(float(surface.distance(foothold))) > SAME_PLANE:
            raise InputError(
                f"foothold of '{name}' in phase '{self.name}' lies {surface.distance(foothold):g} m off its"
                " surface",
                f"allowed: within {SAME_PLANE:g} m",
            )

    def surface(self, contact: str, terrain: FlatGround) -> Surface:
        """What an active contact touches in this phase: its own surface, or the terrain."""
        return self.surfaces.get(contact, terrain.surface)

    def _require_bounds(self, bounds: tuple[float, float]) -> None:
        try:
            lower, upper = (float(bound) for bound in bounds)
        except (TypeError, ValueError):
            lower = upper = math.nan
        if not 0 < lower <= self.duration <= upper < math.inf:
            raise InputError(
                f"duration_bounds of phase '{self.name}' are {bounds} s",
                f"allowed: (lower, upper), finite, 0 < lower <= duration = {self.duration:g} <= upper",
            )
        object.__setattr__(self, "duration_bounds", (lower, upper))


@dataclass(frozen=True)
class Schedule:
    """Phases in time order."""

    phases: tuple[Phase, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "phases", tuple(self.phases))
        if not self.phases:
            raise InputError("the schedule has no phase", "allowed: at least one phase")
        for index, phase in enumerate(self.phases):
            if phase.impact and index == 0:
                raise InputError(
                    f"the first phase '{phase.name}' begins with an impact",
                    "allowed: impact=True where a contact begins after another phase",
                )
            if phase.impact and not self.new_contacts(index):
                raise InputError(
                    f"phase '{phase.name}' begins with an impact, but no contact begins with it",
                    "allowed: impact=True where a contact begins",
                )

    @property
    def duration(self) -> float:
        """Total nominal duration in s."""
        return sum(phase.duration for phase in self.phases)

    @property
    def duration_range(self) -> tuple[float, float]:
        """Shortest and longest total duration in s that the phases allow."""
        bounds = [phase.duration_bounds or (phase.duration, phase.duration) for phase in self.phases]
        return sum(low for low, _ in bounds), sum(high for _, high in bounds)

    @property
    def clocks(self) -> tuple[int | None, ...]:
        """Number of the clock of every phase: free durations are counted, the others have None."""
        free = [phase.duration_bounds is not None for phase in self.phases]
        return tuple(sum(free[:i]) if own else None for i, own in enumerate(free))

    def require_steady_surfaces(self, terrain: FlatGround) -> None:
        """Raise InputError if a contact stays active from one phase to the next but on another plane."""
        for before, after in pairwise(self.phases):
            for name in set(before.contacts) & set(after.contacts):
                if not before.surface(name, terrain).same_plane(after.surface(name, terrain)):
                    raise InputError(
                        f"'{name}' is in contact in phases '{before.name}' and '{after.name}' on two planes",
                        "allowed: the same plane, or a phase between them without the contact",
                    )

    def new_contacts(self, index: int) -> tuple[str, ...]:
        """Contacts that begin with phase ``index``; those of the first phase hold already."""
        if index == 0:
            return ()
        before = self.phases[index - 1].contacts
        return tuple(name for name in self.phases[index].contacts if name not in before)

    def beginning(self, contact: str, index: int) -> int:
        """Phase with which an active contact of phase ``index`` began; 0 if it holds from the start."""
        while index and contact in self.phases[index - 1].contacts:
            index -= 1
        return index

    def kept_contacts(self, index: int) -> tuple[str, ...]:
        """Contacts of phase ``index`` that held before it."""
        return tuple(name for name in self.phases[index].contacts if name not in self.new_contacts(index))

    def intervals(self, total: int) -> tuple[int, ...]:
        """Share ``total`` intervals among the phases by duration, at least one each.

        Raises InputError when there are fewer intervals than phases.
        """
        if total < len(self.phases):
            raise InputError(
                f"{total} intervals for {len(self.phases)} phases", f"allowed: at least {len(self.phases)}"
            )
        ideal = np.array([phase.duration for phase in self.phases]) / self.duration * total
        counts = np.maximum(1, np.floor(ideal).astype(int))
        while counts.sum() < total:
            counts[np.argmax(ideal / counts)] += 1
        while counts.sum() > total:
            spare = np.where(counts > 1, counts / ideal, -np.inf)
            counts[np.argmax(spare)] -= 1
        return tuple(int(count) for count in counts)


@dataclass(frozen=True, kw_only=True)
class FlatGround:
    """A plane to stand on with Coulomb friction: level, or a slope.

    ``height`` in m over the world's origin; ``friction`` coefficient; ``normal`` (3,) upwards, made a unit
    vector, (0, 0, 1) for level ground. Raises `InputError`.
    """

    height: float = 0.0
    friction: float = 0.7
    normal: tuple[float, float, float] = UP

    def __post_init__(self) -> None:
        if not (math.isfinite(self.friction) and self.friction >= 0):
            raise InputError(f"friction coefficient is {self.friction:g}", "allowed: finite and >= 0")
        if not math.isfinite(self.height):
            raise InputError(f"ground height is {self.height:g} m", "allowed: finite")
        normal = self.surface.normal
        if not normal[2] > 0:
            raise InputError(f"normal of the ground is {self.normal}", "allowed: upwards, z > 0")
        object.__setattr__(self, "normal", tuple(normal.tolist()))

    @property
    def surface(self) -> Surface:
        """The ground as a surface that contacts touch."""
        point = np.array([0.0, 0.0, self.height])
        return Surface(point=point, normal=np.array(self.normal), friction=self.friction)

    def describe(self) -> dict[str, object]:
        """JSON-able description for a solution file."""
        return {
            "kind": "flat",
            "height": self.height,
            "normal": list(self.normal),
            "friction": self.friction,
        }

"""Contact-mode schedules: which contacts are active, and for how long."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from trajopt.arguments import Array3, Positive, checked
from trajopt.errors import InputError
from trajopt.robot.contact import Contact
from trajopt.schedule.moment import Moment
from trajopt.terrain.patch import Patch
from trajopt.terrain.surface import SAME_PLANE, Surface
from trajopt.terrain.terrain import Ground, Terrain

# Configuration (nq,) as a function of time in s: a guess or a reference.
Motion = Callable[[float], np.ndarray]


@checked
@dataclass(frozen=True, kw_only=True)
class Phase:
    """A stretch of motion with a constant set of active contacts.

    Args:
        name: name of the phase.
        duration: nominal duration, s; with ``duration_bounds`` the guess.
        contacts: names of the active contacts.
        footholds: ground points (3,), world, m, at which new contacts of the phase land, by the contact's
            name. A contact with a radius touches there, with its centre above. Without a foothold a contact
            only has to touch the terrain.
        duration_bounds: (lower, upper) in s, which make the duration free.
        impact: whether new contacts land with a rigid impact, in which velocities jump, instead of at zero
            velocity.
        surfaces: surfaces that active contacts touch instead of the terrain, by the contact's name: a wall, a
            step, a handrail.
        patches: bounded faces, by the contact's name; a new contact lands anywhere on its patch and stays
            there while it is active.

    Raises:
        InputError: for durations that are not positive, and inconsistent contacts, footholds, surfaces or
            patches.
    """

    name: str
    duration: Positive
    contacts: tuple[str, ...] = ()
    footholds: Mapping[str, Array3] = field(default_factory=dict)
    duration_bounds: tuple[float, float] | None = None
    impact: bool = False
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    patches: Mapping[str, Patch] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.duration_bounds is not None:
            lower, upper = self.duration_bounds
            if not 0 < lower <= self.duration <= upper < math.inf:
                raise InputError(
                    f"duration_bounds of phase '{self.name}' are {self.duration_bounds} s",
                    f"allowed: (lower, upper), finite, 0 < lower <= duration = {self.duration:g} <= upper",
                )
        if len(set(self.contacts)) != len(self.contacts):
            raise InputError(
                f"phase '{self.name}' names a contact twice: {', '.join(self.contacts)}",
                "allowed: each contact once",
            )
        for what, given in (
            ("foothold", self.footholds),
            ("surface", self.surfaces),
            ("patch", self.patches),
        ):
            unknown = set(given) - set(self.contacts)
            if unknown:
                raise InputError(
                    f"phase '{self.name}' has a {what} for {', '.join(sorted(unknown))}",
                    "allowed: contacts that are active in the phase",
                )
        for name in self.surfaces.keys() & self.patches.keys():
            raise InputError(
                f"'{name}' has a surface and a patch in phase '{self.name}'", "allowed: one of them"
            )
        for name, point in self.footholds.items():
            self._require_on_ground(name, point)
        for label in ("footholds", "surfaces", "patches"):
            object.__setattr__(self, label, MappingProxyType(dict(getattr(self, label))))

    def _require_on_ground(self, name: str, foothold: np.ndarray) -> None:
        surface, patch = self.surfaces.get(name), self.patches.get(name)
        if surface is not None and abs(float(surface.distance(foothold))) > SAME_PLANE:
            raise InputError(
                f"foothold of '{name}' in phase '{self.name}' lies {surface.distance(foothold):g} m off its"
                " surface",
                f"allowed: within {SAME_PLANE:g} m",
            )
        if patch is None:
            return
        off, inside = abs(float(patch.surface.distance(foothold))), float(patch.inside(foothold))
        if off > SAME_PLANE or inside < patch.margin - SAME_PLANE:
            raise InputError(
                f"foothold of '{name}' in phase '{self.name}' is {off:g} m off the plane of patch"
                f" '{patch.name}' and {inside:g} m inside its edges",
                f"allowed: on the plane, at least the margin {patch.margin:g} m inside",
            )

    def own_surface(self, contact: str) -> Surface | None:
        """The surface or the patch's surface that this phase names for a contact; None if it names none."""
        if contact in self.patches:
            return self.patches[contact].surface
        return self.surfaces.get(contact)

    def surface(self, contact: str, terrain: Terrain, radius: float = 0.0) -> Ground:
        """The ground of an active contact according to this phase alone.

        This is its surface or its patch's, else the terrain at its foothold, else the terrain. With a
        ``radius`` in m it is the parallel surface on which the contact's centre lies. See `Schedule.surface`
        for contacts that hold from an earlier phase.
        """
        ground: Ground | None = self.own_surface(contact)
        if ground is None:
            place = self.footholds.get(contact)
            ground = terrain.surface if place is None else terrain.surface_at(place)
        return ground.offset(radius)

    def centre(self, contact: Contact, terrain: Terrain) -> np.ndarray | None:
        """Where the origin (3,) of a contact's frame lands, m, world; None if it has no foothold."""
        place = self.footholds.get(contact.name)
        if place is None or not contact.radius:
            return place
        normal = self.surface(contact.name, terrain).plane_at(place).normal
        return np.asarray(place + contact.radius * normal)


@checked
@dataclass(frozen=True)
class Schedule:
    """Phases in time order."""

    phases: tuple[Phase, ...]

    def __post_init__(self) -> None:
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
    def names(self) -> tuple[str, ...]:
        """Names of the phases."""
        return tuple(phase.name for phase in self.phases)

    @property
    def duration(self) -> float:
        """Total nominal duration in s."""
        return sum(phase.duration for phase in self.phases)

    @property
    def duration_range(self) -> tuple[float, float]:
        """Shortest and longest total duration in s that the phases allow."""
        bounds = [phase.duration_bounds or (phase.duration, phase.duration) for phase in self.phases]
        return sum(low for low, _ in bounds), sum(high for _, high in bounds)

    def phases_at(self, moment: Moment) -> tuple[int, ...]:
        """Indices of the phases that meet at a moment, that of the moment last."""
        index = len(self.phases) - 1 if moment.phase is None else self.names.index(moment.phase)
        other = index + {0.0: -1, 1.0: 1}.get(moment.fraction, 0)
        return (other, index) if 0 <= other < len(self.phases) and other != index else (index,)

    @property
    def time_scales(self) -> tuple[int | None, ...]:
        """Index of the time scale of every phase of free duration, None for the others."""
        free = [phase.duration_bounds is not None for phase in self.phases]
        return tuple(sum(free[:i]) if is_free else None for i, is_free in enumerate(free))

    def surface(
        self,
        index: int,
        contact: str,
        terrain: Terrain,
        starts: Mapping[str, np.ndarray] = MappingProxyType({}),
        radius: float = 0.0,
    ) -> Ground:
        """The ground of an active contact: the surface its phase states, or the one it landed on.

        A patch, or the terrain under a foothold, stays the ground as long as the contact is active.

        Args:
            index: index of the phase.
            contact: name of the contact.
            terrain: the ground.
            starts: ground points (3,) that contacts touch at the start, m, by name, for contacts without any
                of these.
            radius: radius of the contact, m, for the parallel surface on which its centre lies.
        """
        stated, patch = self.phases[index].own_surface(contact), self.patch(index, contact)
        ground: Ground | None = stated if stated is not None or patch is None else patch.surface
        if ground is None:
            begins = self.beginning(contact, index)
            place = self.phases[begins].footholds.get(contact, None if begins else starts.get(contact))
            ground = terrain.surface if place is None else terrain.surface_at(place)
        return ground.offset(radius)

    def patch(self, index: int, contact: str) -> Patch | None:
        """The patch on which an active contact of phase ``index`` stands, None if none was named."""
        for phase in reversed(self.phases[self.beginning(contact, index) : index + 1]):
            if phase.own_surface(contact) is not None:
                return phase.patches.get(contact)
        return None

    def require_steady_surfaces(
        self, terrain: Terrain, starts: Mapping[str, np.ndarray] = MappingProxyType({})
    ) -> None:
        """Raise InputError if a contact stays active into the next phase but on another plane."""
        for index, (before, after) in enumerate(pairwise(self.phases)):
            for name in set(before.contacts) & set(after.contacts):
                surfaces = [self.surface(i, name, terrain, starts) for i in (index, index + 1)]
                if not surfaces[0].same_plane(surfaces[1]):
                    raise InputError(
                        f"'{name}' is in contact in phases '{before.name}' and '{after.name}' on two planes",
                        "allowed: the same plane, or a phase between them without the contact",
                    )
                patch, named = self.patch(index, name), after.patches.get(name)
                same = patch is not None and named is not None and patch.describe() == named.describe()
                if not (named is None or named is patch or same):
                    raise InputError(
                        f"'{name}' is in contact in phases '{before.name}' and '{after.name}' on two patches",
                        "allowed: the patch on which it landed, or none named again",
                    )

    def new_contacts(self, index: int) -> tuple[str, ...]:
        """Contacts that begin with phase ``index``; none in the first phase, whose contacts hold already."""
        if index == 0:
            return ()
        before = self.phases[index - 1].contacts
        return tuple(name for name in self.phases[index].contacts if name not in before)

    def beginning(self, contact: str, index: int) -> int:
        """Index of the phase with which an active contact of phase ``index`` began; 0 is the start."""
        while index and contact in self.phases[index - 1].contacts:
            index -= 1
        return index

    def kept_contacts(self, index: int) -> tuple[str, ...]:
        """Contacts of phase ``index`` that were active before it."""
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

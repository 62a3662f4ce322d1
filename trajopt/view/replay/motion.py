"""The motion of a replay: a solution at a constant frame rate, as placements in the world."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.errors import InputError, is_number
from trajopt.motion.configurations import geodesic_configurations
from trajopt.motion.solution import Solution
from trajopt.motion.touched import TouchedSurfaces, held_contacts, touched_surfaces
from trajopt.robot.contact import centre_of_pressure

# Pictures a second of playback: what screens show.
FRAME_RATE = 60.0
# Playback speed beyond which nothing is seen.
FASTEST = 1e3
# Most frames: all are computed and written before the first one is shown.
MOST_FRAMES = 100_000
# Time for which an impulse is shown (s of the solution), as the constant force with that impulse.
FLASH = 0.1
# A sole pressed with less than this fraction of the weight has no meaningful centre of pressure.
LEAST_PRESSURE = 1e-3


@dataclass(frozen=True, kw_only=True)
class PhaseSpan:
    """A phase by name with its start and end, s."""

    name: str
    start: float
    end: float


def phase_spans(solution: Solution) -> list[PhaseSpan]:
    """Return the phases in time order."""
    return [
        PhaseSpan(
            name=solution.phase_names[int(solution.phase[rows.start])],
            start=float(solution.t[rows.start]),
            end=float(solution.t[rows.stop - 1]),
        )
        for rows in solution.phases
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class ReplayMotion:
    """A solution at n frames; njoints counts the universe, nc the contacts.

    Args:
        t: times (n,) of the solution, s.
        frame_rate, speed: frames per second of playback; solution time over playback time.
        q, joints, phase: configurations (n, nq), world placements (n, njoints, 4, 4), phases (n,).
        contacts: world placements (n, nc, 4, 4) of contact frames, moved by their radii to the surfaces.
        touched: the surfaces that contacts touch.
        wrench: (n, nc, 6) N and N m, as in the solution.
        impact: (n, nc, 6) impulse over `FLASH` while it is shown, else zero.
        active, soles: (n, nc) which contacts are active, and which are soles on unilateral surfaces.
        last, part: (n,) the sample that begins the span of each frame, and the fraction of the span.
        weight: N.
    """

    t: np.ndarray
    frame_rate: float
    speed: float
    q: np.ndarray
    joints: np.ndarray
    contacts: np.ndarray
    touched: TouchedSurfaces
    wrench: np.ndarray
    impact: np.ndarray
    active: np.ndarray
    soles: np.ndarray
    last: np.ndarray
    part: np.ndarray
    phase: np.ndarray
    weight: float

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.t)

    @property
    def duration(self) -> float:
        """Playback time, s."""
        return (self.n_frames - 1) / self.frame_rate

    @property
    def feet(self) -> np.ndarray:
        """World positions (n, nc, 3) of the contacts where they touch, m."""
        return np.asarray(self.contacts[:, :, :3, 3])

    @property
    def force(self) -> np.ndarray:
        """Contact forces (n, nc, 3) in world axes, N."""
        return np.asarray(self.wrench[:, :, :3])

    def pressed(self, wrench: np.ndarray) -> np.ndarray:
        """Points (n, nc, 3), m, where wrenches (n, nc, 6) act: centres of pressure of soles, or contacts."""
        normal, force, moment = self.contacts[:, :, :3, 2], wrench[:, :, :3], wrench[:, :, 3:]
        pressed = self.soles & (np.sum(normal * force, axis=-1) > LEAST_PRESSURE * self.weight)
        return self.feet + np.where(pressed[:, :, None], centre_of_pressure(force, moment, normal), 0.0)

    def between(self, values: np.ndarray) -> np.ndarray:
        """Values (n, ...) at the frames, interpolated linearly from ``values`` (K, ...) at samples."""
        part = self.part.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1 - part) * values[self.last] + part * values[self.last + 1])


def require_speed(speed: float) -> None:
    """Raise `InputError` unless a ``speed`` of playback is a positive number."""
    if not (is_number(speed) and 0 < speed <= FASTEST):
        shown = f"{speed:g}" if isinstance(speed, int | float) else repr(speed)
        raise InputError(f"speed is {shown}", f"allowed: > 0 to {FASTEST:g}; 1 is real time")


def replay_motion(solution: Solution, speed: float = 1.0) -> ReplayMotion:
    """The motion of one solution: see `replay_motions`."""
    return replay_motions([solution], speed)[0]


def replay_motions(solutions: Sequence[Solution], speed: float = 1.0) -> list[ReplayMotion]:
    """Resample solutions on the manifold at about `FRAME_RATE`, all from the first start to the last end.

    A solution is held before its start and after its end. Forces are interpolated linearly within an
    interval. Raises `InputError` for a motion of no duration and a speed that is not positive, and
    `SolutionFileError` for terrain or surfaces that cannot be read.
    """
    require_speed(speed)
    if not solutions:
        raise InputError("there is nothing to replay", "one or more solutions")
    for solution in solutions:
        if not solution.t[-1] > solution.t[0]:
            raise InputError("the solution lasts 0 s", "a replay needs a duration")
    start = float(min(solution.t[0] for solution in solutions))
    duration = float(max(solution.t[-1] for solution in solutions)) - start
    if duration / speed * FRAME_RATE > MOST_FRAMES:
        longest = MOST_FRAMES / FRAME_RATE
        raise InputError(f"a replay of {duration / speed:g} s", f"allowed: {longest:g} s; a higher speed")
    steps = max(1, round(duration / speed * FRAME_RATE))
    t = start + duration * np.linspace(0.0, 1.0, steps + 1)
    return [_resampled(solution, t, steps * speed / duration, speed) for solution in solutions]


def _resampled(solution: Solution, t: np.ndarray, frame_rate: float, speed: float) -> ReplayMotion:
    q = geodesic_configurations(solution, t)
    joints, contacts = placements(solution.model, solution.contact_ids, q)
    last, part = spans(solution.t, t)
    surfaces = touched_surfaces(solution.description, contacts[:, :, :3, 3], solution.phase[last])
    contacts[:, :, :3, 3] = surfaces.touching(contacts[:, :, :3, 3])
    mass = mass_of(solution.model)
    return ReplayMotion(
        t=t,
        frame_rate=frame_rate,
        speed=speed,
        q=q,
        joints=joints,
        contacts=contacts,
        touched=surfaces.ground,
        wrench=(1 - part)[:, None, None] * solution.f[last] + part[:, None, None] * solution.f[last + 1],
        impact=_impacts(solution, t),
        active=solution.active[last],
        soles=~held_contacts(solution.description, solution.phase[last]) & solution.description.soles,
        last=last,
        part=part,
        phase=solution.phase[last],
        weight=mass * gravity_of(solution.model) if mass > 0 else 1.0,
    )


def placements(model: pin.Model, frames: Sequence[int], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World placements of the joints (n, njoints, 4, 4) and of ``frames`` (n, f, 4, 4) at ``q`` (n, nq)."""
    data = model.createData()
    joints = np.empty((len(q), model.njoints, 4, 4))
    contacts = np.empty((len(q), len(frames), 4, 4))
    for row, configuration in enumerate(q):
        pin.framesForwardKinematics(model, data, configuration)
        for joint in range(model.njoints):
            joints[row, joint] = data.oMi[joint].homogeneous
        for column, frame in enumerate(frames):
            contacts[row, column] = data.oMf[frame].homogeneous
    return joints, contacts


def spans(nodes: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index (n,) of the node (K,) that begins the span of each time, and the fraction (n,) of the span."""
    last = np.clip(np.searchsorted(nodes, t, side="right") - 1, 0, max(len(nodes) - 2, 0))
    span = nodes[np.minimum(last + 1, len(nodes) - 1)] - nodes[last]
    part = np.where(span > 0, (t - nodes[last]) / np.where(span > 0, span, 1.0), 1.0)
    return last, np.clip(part, 0.0, 1.0)


def _impacts(solution: Solution, t: np.ndarray) -> np.ndarray:
    """Impulses over `FLASH` (n, nc, 6) at the frames that show them: at least one frame each."""
    impact = np.zeros((len(t), len(solution.contact_frames), 6))
    if solution.impulse is None or solution.impact_index is None:
        return impact
    for impulse, sample in zip(solution.impulse, solution.impact_index, strict=True):
        first = min(int(np.searchsorted(t, solution.t[sample])), len(t) - 1)
        end = max(int(np.searchsorted(t, solution.t[sample] + FLASH)), first + 1)
        struck = impulse.any(axis=1)
        impact[first:end, struck] = impulse[struck] / FLASH
    return impact

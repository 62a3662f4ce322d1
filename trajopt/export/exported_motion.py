"""A motion as exported: evenly sampled, cycle after cycle, with joints and links by name."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin

from trajopt.arguments import Positive, PositiveCount, checked
from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.export.formats import RATE
from trajopt.export.links import LinkMotion, link_motion
from trajopt.motion.consistency import SAME_TIME
from trajopt.motion.cycles import CycleImage, passes_of
from trajopt.motion.input import SolutionOrFile, require_motion, solution_of
from trajopt.motion.sampling import MOST_SAMPLES
from trajopt.motion.solution import Solution
from trajopt.pickling import picklable

# Largest rate of a motion that ends at rest, relative to its largest rate: solvers leave less.
AT_REST = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class SingleJoints:
    """Joints of one degree of freedom: names (d,), rows (d,) in v, and places (d,) of their first entry in q.

    counted: (d,) whether q holds the cosine and sine of the angle.
    """

    names: tuple[str, ...]
    rows: np.ndarray
    places: np.ndarray
    counted: np.ndarray


def single_joints(plan: Solution) -> SingleJoints:
    """The joints other than the base; raises `InputError` for one with several degrees of freedom."""
    single = Coordinates(plan.model).joints[BASE_JOINT[base_of(plan.model)] :]
    for joint in single:
        if joint.v.stop - joint.v.start != 1:
            raise InputError(
                f"joint '{joint.name}' has several degrees of freedom", "allowed: one, beside a moving base"
            )
    return SingleJoints(
        names=tuple(joint.name for joint in single),
        rows=np.array([joint.v.start for joint in single], dtype=int),
        places=np.array([joint.q.start for joint in single], dtype=int),
        counted=np.array([joint.is_counted for joint in single], dtype=bool),
    )


def joint_angles(joints: SingleJoints, q: np.ndarray, v: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Positions (n, d) of joints at times ``t`` (n,), rad or m; continuous where q has cosine and sine.

    The velocities tell how many whole turns a continuous joint makes from sample to sample.
    """
    angles = q[:, joints.places]
    for column in np.flatnonzero(joints.counted):
        place = joints.places[column]
        angle = np.arctan2(q[:, place + 1], q[:, place])
        rate = v[:, joints.rows[column]]
        expected = (rate[1:] + rate[:-1]) / 2 * np.diff(t)
        turns = np.round((expected - np.diff(angle)) / (2 * np.pi))
        angles[:, column] = angle + 2 * np.pi * np.append(0.0, np.cumsum(turns))
    return angles


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class ExportedMotion:
    """A motion at n times, ``rate`` per second; SI units, world axes unless stated; arrays are read-only.

    Args:
        plan: the solution.
        cycles: number of repetitions of a periodic plan.
        t: (n,) s, from 0.
        q: (n, nq) of Pinocchio, quaternions xyzw.
        v: (n, nv), the twist of the base along its axes.
        a: (n, nv).
        tau: (n, nu), as in `SampledMotion`.
        drive_torque: (n, nu), as in `SampledMotion`.
        f: (n, nc, 6), wrenches of the plan's contacts.
        active: (n, nc), whether contacts are active.
        phase: (n,) index into ``phase_names``, which holds the phases of all cycles one after the other.
        joint_names: the d joints other than a moving base, in Pinocchio's order.
        joint_position: (n, d), with whole turns.
        joint_velocity: (n, d).
        joint_acceleration: (n, d).
        joint_torque: (n, d) of the drives; 0 for passive joints.
        links: poses and velocities of all links.
    """

    plan: Solution
    rate: float
    cycles: int
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    drive_torque: np.ndarray
    f: np.ndarray
    active: np.ndarray
    phase: np.ndarray
    phase_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    joint_position: np.ndarray
    joint_velocity: np.ndarray
    joint_acceleration: np.ndarray
    joint_torque: np.ndarray
    links: LinkMotion

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def model(self) -> pin.Model:
        """The model that was optimised."""
        return self.plan.model

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return str(self.plan.description.robot)

    @property
    def problem(self) -> str:
        """Name of the problem."""
        return str(self.plan.description.problem)


@checked
def sample_cycles(
    solution: SolutionOrFile, rate: Positive = RATE, cycles: PositiveCount = 1, *, even: bool = True
) -> ExportedMotion:
    """Sample a motion at ``rate`` from the polynomials of its intervals; a switch has the values after it.

    Args:
        solution: the plan, or the path of its file.
        rate: samples per second, Hz.
        cycles: of a periodic plan, each continuing the previous one; half a cycle counts with its mirror
            image, as in `simulate`.
        even: whether all steps are equal. A remainder at the end shorter than a step is then a whole step if
            the motion ends at rest, else it is left out. If not, it is the last step.

    Raises:
        InputError: for a rate that gives over 200,000 samples, several cycles of a plan that is not periodic,
            or joints other than the base with several degrees of freedom.
    """
    plan = require_motion(solution_of(solution))
    joints = single_joints(plan)
    passes = passes_of(plan, cycles)
    start, end = float(plan.interval_t[0, 0]), float(plan.interval_t[-1, 1])
    slack, duration = SAME_TIME * (end - start), (end - start) * passes
    times = _even_times(duration, rate)
    if duration - times[-1] > slack and (not even or _ends_at_rest(plan)):
        times = np.append(times, len(times) / rate if even else duration)
    number = np.clip(np.floor((times + slack) / (end - start)).astype(int), 0, passes - 1)
    samples = plan.sample(times=np.clip(start + times - number * (end - start), start, end))
    arrays = {
        name: np.array(getattr(samples, name))
        for name in ("q", "v", "a", "tau", "drive_torque", "f", "active")
    }
    if passes > 1:
        _move_on(CycleImage.of(plan), arrays, number, passes)
    return _named_motion(
        plan, joints, arrays, rate=rate, cycles=cycles, t=times, number=number, phase=samples.phase
    )


def _even_times(duration: float, rate: float) -> np.ndarray:
    steps = duration * rate
    if steps >= MOST_SAMPLES:
        raise InputError(
            f"rate is {rate:g} Hz, {steps:.3g} samples in {duration:g} s", f"allowed: {MOST_SAMPLES} samples"
        )
    return np.arange(int(steps * (1 + SAME_TIME) + SAME_TIME) + 1) / rate


def _ends_at_rest(plan: Solution) -> bool:
    return bool(np.abs(plan.v[-1]).max() <= AT_REST * np.abs(plan.v).max())


def _move_on(image: CycleImage, arrays: dict[str, np.ndarray], number: np.ndarray, passes: int) -> None:
    """Replace samples of pass ``number`` (n,) by their images, once per preceding pass."""
    for past in range(1, passes):
        rows = number >= past
        arrays["q"][rows], arrays["v"][rows] = image.of_states(arrays["q"][rows], arrays["v"][rows])
        arrays["a"][rows] = image.of_accelerations(arrays["a"][rows])
        for name in ("tau", "drive_torque"):
            arrays[name][rows] = image.of_torques(arrays[name][rows])
        arrays["f"][rows] = image.of_contact_forces(arrays["f"][rows])
        arrays["active"][rows] = image.of_contacts(arrays["active"][rows])


def _named_motion(
    plan: Solution,
    joints: SingleJoints,
    arrays: dict[str, np.ndarray],
    *,
    rate: float,
    cycles: int,
    t: np.ndarray,
    number: np.ndarray,
    phase: np.ndarray,
) -> ExportedMotion:
    torque = plan.actuation.force(arrays["drive_torque"])
    return ExportedMotion(
        plan=plan,
        rate=float(rate),
        cycles=cycles,
        t=t,
        **arrays,
        phase=phase + number * len(plan.phase_names),
        phase_names=plan.phase_names * (int(number[-1]) + 1),
        joint_names=joints.names,
        joint_position=joint_angles(joints, arrays["q"], arrays["v"], t),
        joint_velocity=arrays["v"][:, joints.rows],
        joint_acceleration=arrays["a"][:, joints.rows],
        joint_torque=torque[:, joints.rows],
        links=link_motion(plan.model, arrays["q"], arrays["v"]),
    )


def require_one_robot(motions: Sequence[ExportedMotion]) -> None:
    """Raise `InputError` for motions of different robots."""
    robots = {motion.robot for motion in motions}
    if len(robots) > 1:
        raise InputError(f"motions of {len(robots)} robots: {', '.join(sorted(robots))}", "allowed: of one")

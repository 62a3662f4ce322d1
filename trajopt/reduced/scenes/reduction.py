"""The map between a whole robot and a smaller one, for states, forces and solutions.

Every joint of the whole robot is either locked at its start or follows a joint of the small robot: its own
counterpart, or with a sign its mirror image. Rates, accelerations and derivatives of the local coordinates
follow linearly, v = E v_small. A joint that stands for n mirrored ones has n times their torque, a contact n
times their force.

Halving a free-flyer robot leaves the coordinates (x, z, pitch) of its base, pitch positive with the nose up:

    p = (x, y0, z),   R = R_y(-pitch),   v = (v_x, 0, v_z), (0, -pitch', 0) in the base's axes
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_COORDINATES, BASE_ROWS
from trajopt.dynamics.model_quantities import contact_jacobian, generalized_force
from trajopt.dynamics.rerooting import joint_slices
from trajopt.motion.grid import interpolated
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot.contact import set_rolling_moments
from trajopt.robot.mirror import REFLECTION, TWIST, signed
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase
from trajopt.solving.extraction import contact_activity, described_robot
from trajopt.terms.interfaces import NodePlace

# Rows of a free-flyer's twist that a planar base keeps, and their signs: forward, up, pitch about -y.
PLANAR_ROWS = ((0, 1.0), (2, 1.0), (4, -1.0))


_Slices = tuple[slice, slice]
_Trajectory = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class FollowingPart:
    """The joint or contact of the small robot that a part of the whole robot follows, mirrored or not."""

    name: str
    sign: float = 1.0
    mirrored: bool = False

    def behind(self, other: FollowingPart) -> FollowingPart:
        """Return the composition with ``other``, which this part's leader follows in turn."""
        return FollowingPart(other.name, self.sign * other.sign, self.mirrored != other.mirrored)


@dataclass(frozen=True, kw_only=True, eq=False)
class Reduction:
    """The map from a ``whole`` robot to a ``small`` one; locked joints rest at ``start`` (nq of the whole).

    joints: what each joint outside the base follows; joints not listed are locked.
    contacts: what each contact follows; contacts not listed are never active.
    mirrored_frames: frames on limbs that exist in the small robot only as mirror images.
    """

    whole: Robot
    small: Robot
    start: np.ndarray
    joints: Mapping[str, FollowingPart]
    contacts: Mapping[str, FollowingPart]
    mirrored_frames: frozenset[str] = field(default=frozenset())

    @property
    def is_half(self) -> bool:
        """Whether the small robot is the mirror-symmetric half of the whole one."""
        return self.small.base == "planar" and self.whole.base != "planar"

    @property
    def y0(self) -> float:
        """The y coordinate of a half's plane, m."""
        return float(self.start[1])

    def then(self, second: Reduction) -> Reduction:
        """Return the composition with a reduction of this one's small robot."""
        return replace(
            self,
            small=second.small,
            joints=_followed(self.joints, second.joints),
            contacts=_followed(self.contacts, second.contacts),
            mirrored_frames=self.mirrored_frames | second.mirrored_frames,
        )

    def members(self, name: str) -> int:
        """Number of joints of the whole robot that follow the small robot's joint ``name``."""
        return sum(follower.name == name for follower in self.joints.values())

    def contact_members(self, name: str) -> int:
        """Number of contacts of the whole robot that follow the small robot's contact ``name``."""
        return sum(follower.name == name for follower in self.contacts.values())

    @cached_property
    def rates(self) -> np.ndarray:
        """E of v = E v_small, (nv of the whole, nv of the small)."""
        matrix = np.zeros((self.whole.nv, self.small.nv))
        if self.is_half:
            for column, (row, sign) in enumerate(PLANAR_ROWS):
                matrix[row, column] = sign
        else:
            n = BASE_ROWS[self.whole.base]
            matrix[:n, :n] = np.eye(n)
        for _, (rows, columns), sign in self.entries():
            matrix[rows, columns] = sign * np.eye(rows.stop - rows.start)
        return matrix

    def entries(self) -> Iterator[tuple[_Slices, _Slices, float]]:
        """Yield for every following joint the entries (whole, small) in q, those in v, and the sign."""
        for name, follower in self.joints.items():
            of_whole = joint_slices(self.whole.model, name)
            followed = joint_slices(self.small.model, follower.name)
            yield (of_whole[0], followed[0]), (of_whole[1], followed[1]), follower.sign

    @cached_property
    def shares(self) -> np.ndarray:
        """Matrix (nu, nu of the small) from the small robot's torques to the whole robot's.

        Rows of locked joints are zero: the small robot does not determine their holding torques.
        """
        matrix = self.rates[np.ix_(self.whole.actuated_rows, self.small.actuated_rows)]
        members = np.abs(matrix).sum(axis=0)
        count = len(self.whole.thrusters)
        shares = np.pad(matrix / np.where(members > 0, members, 1.0), (0, count))
        shares[len(matrix) :, matrix.shape[1] :] = np.eye(count)
        return shares

    def lift_q(self, q: np.ndarray) -> np.ndarray:
        """Return the whole robot's configuration (nq,) for one of the small robot."""
        lifted = np.array(self.start, dtype=float)
        n = BASE_COORDINATES[self.whole.base]
        if self.is_half:
            pitch = np.arctan2(q[3], q[2])
            lifted[:7] = [q[0], self.y0, q[1], 0.0, -np.sin(pitch / 2), 0.0, np.cos(pitch / 2)]
        else:
            lifted[:n] = q[:n]
        for (of_whole, followed), _, sign in self.entries():
            lifted[of_whole] = q[followed] if sign > 0 else signed(q[followed], sign)
        return lifted

    def drop_q(self, q: np.ndarray) -> np.ndarray:
        """Return the small robot's configuration nearest to one of the whole robot: images are averaged."""
        small = np.zeros(self.small.nq)
        n = BASE_COORDINATES[self.small.base]
        if self.is_half:
            forward = pin.Quaternion(*q[[6, 3, 4, 5]]).toRotationMatrix()[[0, 2], 0]
            small[:n] = [q[0], q[2], *(forward / np.linalg.norm(forward))]
        else:
            small[:n] = q[:n]
        for (of_whole, followed), _, sign in self.entries():
            small[followed] += q[of_whole] if sign > 0 else signed(q[of_whole], sign)
        for name in {follower.name for follower in self.joints.values()}:
            of_whole = joint_slices(self.small.model, name)[0]
            small[of_whole] /= self.members(name)
        return np.array(pin.normalize(self.small.model, small))

    def drop_v(self, v: np.ndarray) -> np.ndarray:
        """Return the small robot's rates or accelerations nearest to those of the whole, in least squares."""
        return np.asarray(np.linalg.lstsq(self.rates, v, rcond=None)[0])

    def drop_torques(self, limit: np.ndarray) -> np.ndarray:
        """Return the small robot's effort limit (nu,): n times the least limit of the n images of a joint."""
        given, columns = np.asarray(limit, dtype=float), np.abs(self.shares).T
        limits = [np.min(given[share > 0] / share[share > 0], initial=np.inf) for share in columns]
        return np.array(limits)

    def lift_forces(self, f: np.ndarray) -> np.ndarray:
        """Return the wrenches (K, nc, 6) of the whole robot's contacts from the small robot's."""
        names = [contact.name for contact in self.small.contacts]
        lifted = np.zeros((len(f), len(self.whole.contacts), 6))
        for row, contact in enumerate(self.whole.contacts):
            follower = self.contacts.get(contact.name)
            if follower is not None:
                share = f[:, names.index(follower.name)] / self.contact_members(follower.name)
                lifted[:, row] = share * TWIST if follower.mirrored else share
        return lifted

    def reflected_point(self, point: np.ndarray) -> np.ndarray:
        """Return the mirror image (3,) of a world position about the plane of the half, m."""
        return REFLECTION * point + np.array([0.0, 2 * self.y0, 0.0])


def _followed(
    first: Mapping[str, FollowingPart], second: Mapping[str, FollowingPart]
) -> dict[str, FollowingPart]:
    """Return the composition of two maps, without parts whose leader is not in the second."""
    return {name: f.behind(second[f.name]) for name, f in first.items() if f.name in second}


def whole_place(place: NodePlace, reduction: Reduction) -> NodePlace:
    """Return the node with the whole robot's contacts, footholds and surfaces."""
    return replace(place, phase=whole_phase(place.phase, reduction))


def whole_phase(phase: Phase, reduction: Reduction) -> Phase:
    """Return the whole robot's phase for a reduced phase."""
    active = {name: f for name, f in reduction.contacts.items() if f.name in phase.contacts}
    footholds, surfaces, patches = {}, {}, {}
    for name, follower in active.items():
        if follower.name in phase.footholds:
            place = phase.footholds[follower.name]
            footholds[name] = reduction.reflected_point(place) if follower.mirrored else place
        if follower.name in phase.surfaces:
            surface = phase.surfaces[follower.name]
            if follower.mirrored:
                point = reduction.reflected_point(surface.point)
                normal = reduction.reflected_point(surface.normal) - reduction.reflected_point(np.zeros(3))
                surface = replace(surface, point=point, normal=normal)
            surfaces[name] = surface
        if follower.name in phase.patches and not follower.mirrored:  # tasks with patches are not halved
            patches[name] = phase.patches[follower.name]
    return replace(phase, contacts=tuple(active), footholds=footholds, surfaces=surfaces, patches=patches)


def lock_joints(
    robot: Robot, names: Sequence[str], q: np.ndarray, contacts: Collection[str] | None = None
) -> Reduction:
    """Return the reduction that welds joints ``names`` at q (nq,) and keeps ``contacts``, or all of them.

    The small robot keeps the whole robot's reference posture and length, on which units and costs are based.
    """
    kept = tuple(c for c in robot.contacts if contacts is None or c.name in contacts)
    names = robot.locked_with(names)
    fewer = replace(robot, contacts=kept)
    made = Reduction(
        whole=robot,
        small=fewer.with_locked(names, reference=q) if names else fewer,
        start=q,
        joints={name: FollowingPart(name) for name in behind_base(robot) if name not in names},
        contacts={contact.name: FollowingPart(contact.name) for contact in kept},
    )
    small = replace(made.small, reference=made.drop_q(robot.reference), given_length=robot.length)
    return replace(made, small=small)


def behind_base(robot: Robot) -> tuple[str, ...]:
    """Names of all joints that are not part of the base."""
    first = BASE_COORDINATES[robot.base]
    return tuple(robot.model.names[j.id] for j in list(robot.model.joints)[1:] if j.idx_q >= first)


def lift_solution(solution: Solution, problem: Problem, reduction: Reduction) -> Solution:
    """Return the whole robot's solution of ``problem`` for a ``solution`` of the small robot.

    Configurations, rates and contact wrenches follow from the reduction. The two sides of a real robot differ
    slightly, so a half's active contact wrenches get the smallest correction, in scaled units, that satisfies
    the whole robot's base rows. What the contacts cannot provide (in flight, all of it) remains as a residual
    in the check. Torques are the actuated rows of numeric RNEA - J^T f, including those of locked joints.
    """
    whole = reduction.whole
    q = np.array([reduction.lift_q(row) for row in solution.q])
    motion = (q, solution.v @ reduction.rates.T, solution.a @ reduction.rates.T)
    every = contact_activity(whole, problem.schedule)[solution.phase]
    f = reduction.lift_forces(solution.f)
    if reduction.is_half:
        f = _carrying(solution, problem, motion, f, every)
    return replace(
        solution,
        description=replace(solution.description, **described_robot(problem)),
        model=whole.limited_model(),
        q=q,
        v=motion[1],
        a=motion[2],
        f=f,
        tau=_torques(solution, whole, motion, f),
        active=every,
        impulse=None if solution.impulse is None else reduction.lift_forces(solution.impulse),
        row_multiplier=None,  # the small problem's multipliers do not apply
        row_place=None,
        bound_multiplier=None,
        gain=None,
    )


def _carrying(
    solution: Solution, problem: Problem, motion: _Trajectory, f: np.ndarray, active: np.ndarray
) -> np.ndarray:
    """Return the wrenches (K, nc, 6) nearest to ``f`` that satisfy the base rows at collocation points."""
    robot = problem.robot
    model, data, rows = robot.model, robot.model.createData(), robot.unactuated_rows
    frames = [model.getFrameId(contact.frame) for contact in robot.contacts]
    units = np.array([1.0] * 3 + [robot.length] * 3)
    corrected = f.copy()
    for k in np.flatnonzero(solution.collocation & active.any(axis=1)):
        state = (motion[0][k], motion[1][k], motion[2][k])
        missing = generalized_force(model, data, state, frames, f[k])[rows]
        chosen = [
            (c, row) for c, row in zip(robot.contacts, range(len(frames)), strict=True) if active[k, row]
        ]
        arms, places = problem.levers[int(solution.phase[k])], [(c.frame, c.rows) for c, _ in chosen]
        jacobian = contact_jacobian(model, state[0], places, [arms.get(c.name) for c, _ in chosen])[:, rows]
        scale = np.concatenate([units[list(c.rows)] for c, _ in chosen])
        change = scale * np.linalg.lstsq((scale[:, None] * jacobian).T, missing, rcond=None)[0]
        for contact, row in chosen:
            corrected[k, row, list(contact.rows)] += change[: contact.dimension]
            change = change[contact.dimension :]
        set_rolling_moments(corrected[k], robot.contacts, arms)
    return interpolated(solution, corrected)


def _torques(solution: Solution, robot: Robot, motion: _Trajectory, f: np.ndarray) -> np.ndarray:
    """Return the actuated rows (K, nu) of RNEA - J^T f at collocation points, interpolated elsewhere."""
    model, data = robot.model, robot.model.createData()
    frames = [model.getFrameId(contact.frame) for contact in robot.contacts]
    forces = np.zeros((solution.n_samples, robot.nv))
    for k in np.flatnonzero(solution.collocation):
        state = (motion[0][k], motion[1][k], motion[2][k])
        forces[k] = generalized_force(model, data, state, frames, f[k])
    return robot.actuation.inputs(interpolated(solution, forces))

"""The simulation itself: planned torques, joint feedback, MuJoCo's physics, and the record.

At the start of each controller period, with the plan's q and v at that time and its torque at mid-period,

    tau = tau_plan + K_p (q_plan - q) + K_d (v_plan - v)        clipped at the limits of the drives

is applied for the whole period; the gains are those of `gains`.
"""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from trajopt.control.limits import limits_with_drives, torque_limits
from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.tracker import Tracker
from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.errors import InputError
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.bodies import body_name, write_inertias
from trajopt.simulation.controllers import TorqueController, controller_of, torque_of
from trajopt.simulation.gains import Gains, gains_of
from trajopt.simulation.record import RequestRecord, SimulationRecord
from trajopt.simulation.settings import Impulse, SimulationSettings
from trajopt.simulation.world import World
from trajopt.solution.solution import Solution

# Horizontal part of the forward axis below which a push is reduced: a vertical base has no side.
LEAST_LEVEL = 0.1
# A push lasts this fraction of the motion, around its middle.
PUSHED = 0.1
# Most physics steps of one simulation: minutes.
MOST_STEPS = 20_000_000
# A contact touches if its force is above this fraction of the weight.
TOUCHING = 1e-3
# Least friction coefficient, as in MuJoCo's own compiler, since MuJoCo takes them to be positive.
LEAST_FRICTION = 1e-5


def run_simulation(
    plan: Solution, reference: ReferenceTrajectory, world: World, settings: SimulationSettings
) -> SimulationRecord:
    """Simulate a plan; the record has one row per period, and the final state."""
    return SimulationRun(plan, reference, world, settings).record()


class SimulationRun:
    """One simulation: of a whole plan by `record`, or of some periods by `advance`."""

    def __init__(
        self, plan: Solution, reference: ReferenceTrajectory, world: World, settings: SimulationSettings
    ) -> None:
        self.mujoco, self.plan, self.reference, self.world = mujoco_package(), plan, reference, world
        self.settings = settings
        self.model = world.compiled
        gravity = np.linalg.norm(self.model.opt.gravity)
        self.up = -self.model.opt.gravity / gravity if gravity > 0 else np.array([0.0, 0.0, 1.0])
        self.data = self.mujoco.MjData(self.model)
        self.substeps = max(1, int(np.ceil(reference.period / settings.step(world.units.time) - 1e-9)))
        if self.substeps * len(reference.t) > MOST_STEPS:
            steps = f"{self.substeps * len(reference.t):.3g}"
            raise InputError(f"a simulation of {steps} steps", f"allowed: {MOST_STEPS}; a longer --timestep")
        self.model.opt.timestep = reference.period / self.substeps
        kind = base_of(plan.model)
        self.base = None if kind == "fixed" else self.model.body(body_name(BASE_JOINT[kind])).id
        self.rows = world.coordinates.rows[plan.actuated_rows]
        self.drives = plan.drives
        self.low, self.high = torque_limits(plan)
        self.controller = controller_of(plan, reference, settings)
        self.tracker = self.controller if isinstance(self.controller, Tracker) else None
        self.touching = reference.active[0]
        self.impulses = settings.impulses
        self._forces: dict[Impulse, np.ndarray] = {}
        self._plan_in_mujoco()
        self.hardware = Hardware(
            self.model,
            settings,
            units=_sizes(world),
            time=world.units.time,
            period=reference.period,
            torque=self.torque[0],
        )

    @cached_property
    def gains(self) -> Gains:
        """Gains of the joint feedback, for every period."""
        return gains_of(self.plan, self.world, self.reference, self.settings)

    def _plan_in_mujoco(self) -> None:
        """Convert the plan and its torques to MuJoCo's coordinates."""
        reference, coordinates = self.reference, self.world.coordinates
        self.qpos = coordinates.to_mujoco(reference.q)
        self.qvel = coordinates.rates_to_mujoco(self.qpos, reference.v)
        self.torque = self._in_mujoco(self.qpos, reference.torque)

    def _in_mujoco(self, qpos: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Convert inputs (n, nu) of the plan to MuJoCo's coordinates: joint torques along MuJoCo's axes."""
        joints = len(self.rows)
        whole = np.zeros((len(torque), self.plan.model.nv))
        whole[:, self.plan.actuated_rows] = torque[:, :joints]
        moved = self.world.coordinates.rates_to_mujoco(qpos, whole)[:, self.rows]
        return np.hstack([moved, torque[:, joints:]])

    def record(self) -> SimulationRecord:
        """Simulate the whole plan from its start."""
        record = self.start()
        return self.ended(record, self.advance(record, 0, len(self.reference.t)))

    def ended(self, record: SimulationRecord, reached: int) -> SimulationRecord:
        """Complete the record with the final state; if it diverged, cut it by `SimulationRecord.until`."""
        if reached < len(self.reference.t):
            return record.until(reached)
        record.qpos[reached], record.qvel[reached] = self.data.qpos, self.data.qvel
        return record

    def start(self) -> SimulationRecord:
        """Set the initial state; returns an empty record for all periods."""
        count, contacts, model = len(self.reference.t), len(self.world.sites), self.model
        self._start()
        return SimulationRecord(
            qpos=np.zeros((count + 1, model.nq)),
            qvel=np.zeros((count + 1, model.nv)),
            qacc=np.zeros((count, model.nv)),
            torque=np.zeros((count, len(self.low))),
            saturated=np.zeros((count, len(self.low)), dtype=bool),
            friction=np.zeros((count, len(self.low))),
            force=np.zeros((count, contacts, 6)),
            feet=np.zeros((count, contacts, 3)),
            turns=np.zeros((count, contacts, 3, 3)),
            touched=np.zeros(count, dtype=bool),
            hit=np.zeros(count, dtype=bool),
            counts=None if self.tracker is None else self.tracker.counts,
            requests=None if self.tracker is None else RequestRecord.empty(count, contacts),
        )

    def branch(self) -> SimulationRun:
        """A copy that continues from here; as they share models, only one run at a time may advance."""
        branched = copy.copy(self)
        branched.data, branched.hardware = copy.copy(self.data), self.hardware.copy()
        branched.tracker = None if self.tracker is None else self.tracker.copy()
        branched.controller = branched.tracker or self.controller
        return branched

    def advance(self, record: SimulationRecord, begin: int, end: int) -> int:
        """Simulate periods ``begin`` to before ``end``; returns ``end``, or where the simulation diverged."""
        model, data = self.model, self.data
        record.force[begin:end] = 0.0  # forces are accumulated
        least = TOUCHING * self.world.units.weight
        changes = set(np.flatnonzero(np.diff(self.reference.source, prepend=-1)).tolist())
        for k in range(begin, end):
            if k in changes or k == begin:
                self._enter(int(self.reference.source[k]))
            self._push(k)
            record.qpos[k], record.qvel[k] = data.qpos, data.qvel
            if not np.isfinite(data.qpos).all() or not np.isfinite(data.qvel).all():
                return k
            record.torque[k], record.saturated[k] = self._drive(k)
            if self.tracker is not None and record.requests is not None:
                record.requests.note(k, self.tracker.request)
            self.mujoco.mj_forward(model, data)  # forces of this state: a step leaves those of its stages
            if not self._is_sane():
                return k
            record.qacc[k], record.friction[k] = data.qacc, self._friction()
            record.feet[k] = data.site_xpos[self.world.sites]
            record.turns[k] = data.site_xmat[self.world.sites].reshape(-1, 3, 3)
            record.touched[k], record.hit[k] = self._contacts(record.force[k], record.feet[k])
            self.touching = np.linalg.norm(record.force[k, :, :3], axis=1) > least
            self.mujoco.mj_step(model, data, self.substeps)
        return end

    def _is_sane(self) -> bool:
        """Whether the state is finite and MuJoCo has not warned of divergence."""
        warned = self.mujoco.mjtWarning
        bad = (warned.mjWARN_BADQPOS, warned.mjWARN_BADQVEL, warned.mjWARN_BADQACC)
        warnings = sum(self.data.warning[kind].number for kind in bad)
        return not warnings and bool(np.isfinite(self.data.qacc).all())

    def _start(self) -> None:
        """Set the planned initial state, with noise if the settings ask for it."""
        self.data.qpos[:], self.data.qvel[:] = self.qpos[0], self.qvel[0]
        if self.settings.noise:
            generator = np.random.default_rng(self.settings.seed)
            size = self.settings.noise * _sizes(self.world)
            error = size * generator.standard_normal(self.model.nv)
            self.mujoco.mj_integratePos(self.model, self.data.qpos, error, 1.0)
            self.data.qvel[:] += size * generator.standard_normal(self.model.nv) / self.world.units.time

    def _enter(self, phase: int) -> None:
        """Apply what changes with a phase of the plan: payloads, grasps, and friction under contacts."""
        changed = self.settings.mass_scale != 1.0 or any(self.settings.com_offset)
        if self.plan.description.payloads or changed:
            write_inertias(self.model, self.world.models[phase])
        for grasp in self.world.grasps:
            self.data.eq_active[self.model.equality(grasp.name).id] = phase in grasp.phases
        friction = np.maximum(self.world.friction[phase], LEAST_FRICTION)
        self.model.pair_friction[self.world.pairs, :2] = friction[:, None]

    def _push(self, k: int) -> None:
        if self.base is None or not (self.settings.push or self.impulses):
            return
        force = np.zeros(3)
        if self.settings.push and abs(k / self.reference.planned - 0.5) < PUSHED / 2:
            level = self.forward()
            aside = level if base_of(self.plan.model) == "planar" else np.cross(self.up, level)
            force += self.settings.push / max(float(np.linalg.norm(aside)), LEAST_LEVEL) * aside
        for impulse in self.impulses:
            force += self._force_of(impulse, k)
        self.data.xfrc_applied[self.base, :3] = force

    def forward(self) -> np.ndarray:
        """Horizontal part (3,) of the base's forward axis in the world."""
        self.mujoco.mj_kinematics(self.model, self.data)
        ahead = self.data.xmat[self.base].reshape(3, 3)[:, 0]
        return np.asarray(ahead - self.up * (self.up @ ahead))

    def _force_of(self, impulse: Impulse, k: int) -> np.ndarray:
        """Force (3,), N, of an impulse in period ``k``; its direction is fixed in its first period."""
        period = self.reference.period
        first, lasts = round(impulse.time / period), max(1, round(impulse.duration / period))
        if k == first:
            level = self.forward()
            along = level / max(float(np.linalg.norm(level)), LEAST_LEVEL)
            turned = np.cos(impulse.direction) * along
            turned = turned + np.sin(impulse.direction) * np.cross(self.up, along)
            self._forces = {**self._forces, impulse: impulse.size / (lasts * period) * turned}
        return self._forces[impulse] if first <= k < first + lasts else np.zeros(3)

    def _drive(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Apply the torques of period ``k``; returns them, and where they were clipped."""
        measured = self.hardware.measure(self.data.qpos, self.data.qvel, self.touching)
        controller = self.controller
        wanted = self._fed_back(k, measured) if controller is None else self._asked(controller, k, measured)
        wanted = self.hardware.command(wanted)
        low, high = self.low, self.high
        if any(drive is not None for drive in self.drives):
            low, high = limits_with_drives(self.drives, self.data.qvel[self.rows], low, high)
        torque = np.clip(wanted, low, high)
        self.hardware.deliver(torque)
        joints = len(self.rows)
        if joints < len(torque):
            thrust = self.plan.actuation.thrust @ torque[joints:]
            pushed = self.world.coordinates.rates_to_mujoco(self.data.qpos[None], thrust[None])
            self.data.qfrc_applied[:] = pushed[0]
        self.data.qfrc_applied[self.rows] = torque[:joints]
        return torque, torque != wanted

    def _fed_back(self, k: int, measured: Measurement) -> np.ndarray:
        """Planned torques with joint feedback (nu,)."""
        error = np.zeros(self.model.nv)
        self.mujoco.mj_differentiatePos(self.model, error, 1.0, measured.qpos, self.qpos[k])
        torque = self.torque[k].copy()
        torque[: len(self.rows)] += self.gains.kp[k] * error[self.rows] + self.gains.kd[k] * (
            self.qvel[k][self.rows] - measured.qvel[self.rows]
        )
        return torque

    def _asked(self, controller: TorqueController, k: int, measured: Measurement) -> np.ndarray:
        """Torques (nu,) of a controller, in MuJoCo's coordinates."""
        coordinates, qpos = self.world.coordinates, measured.qpos[None]
        q = coordinates.from_mujoco(qpos)[0]
        v = coordinates.rates_from_mujoco(qpos, measured.qvel[None])[0]
        t, size = k * self.reference.period, self.plan.tau.shape[1]
        torque = torque_of(controller, t, (q, v), measured.touching, size)
        return self._in_mujoco(qpos, torque[None])[0]

    def _friction(self) -> np.ndarray:
        """Friction torques (nu,) of the drives on their joints: viscous, and Coulomb's as a constraint."""
        whole = self.data.qfrc_passive.copy()
        is_friction = self.data.efc_type == self.mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
        np.add.at(whole, self.data.efc_id[is_friction], self.data.efc_force[is_friction])
        return np.append(whole[self.rows], np.zeros(len(self.low) - len(self.rows)))

    def _contacts(self, force: np.ndarray, feet: np.ndarray) -> tuple[bool, bool]:
        """Add contact wrenches to ``force`` (nc, 6); returns whether a link touches ground, and an obstacle.

        A link that touches the ground next to a foot does not count.
        """
        touching, world = self.data.contact, self.world
        loaded = touching.efc_address >= 0
        geoms = touching.geom[loaded]
        if len(geoms):
            push, owner = self._pushes(loaded), world.contact_of[geoms].max(axis=1, initial=-1)
            # MuJoCo's forces act on the second geom of a pair.
            push *= np.where(world.contact_of[geoms[:, 0]] >= 0, -1.0, 1.0)[:, None]
            arm = touching.pos[loaded] - feet[owner] if len(feet) else np.zeros_like(push)
            wrench = np.column_stack([push, _cross(arm, push)])[owner >= 0]
            np.add.at(force, owner[owner >= 0], wrench)
        self._grasped(force)
        links = world.links[geoms].any(axis=1)
        apart = np.linalg.norm(touching.pos[loaded][links][:, None] - feet, axis=2)
        fallen = (apart > world.feet).all(axis=1)
        return bool(fallen.any()), bool(world.obstacles[geoms].any())

    def _pushes(self, loaded: np.ndarray) -> np.ndarray:
        """Contact forces (n, 3) in world axes; contacts without friction have only a normal force."""
        touching = self.data.contact
        rows = touching.efc_address[loaded][:, None] + np.arange(3)
        forces = self.data.efc_force[np.minimum(rows, self.data.nefc - 1)]
        forces = np.where(np.arange(3) < touching.dim[loaded][:, None], forces, 0.0)
        return np.einsum("ni,nij->nj", forces, touching.frame[loaded].reshape(-1, 3, 3))

    def _grasped(self, force: np.ndarray) -> None:
        """Add the wrenches of grasp constraints: those with the same effect on the joints."""
        for grasp in self.world.grasps:
            number = self.model.equality(grasp.name).id
            if self.data.eq_active[number]:
                holding = (self.data.efc_type == self.mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (
                    self.data.efc_id == number
                )
                rows = self.data.efc_J.reshape(-1, self.model.nv)[holding]
                joint = rows.T @ self.data.efc_force[holding]
                site = self.world.sites[grasp.contact]
                place = np.zeros((6, self.model.nv))
                self.mujoco.mj_jacSite(self.model, self.data, place[:3], place[3:], site)
                size = 6 if grasp.turns else 3
                force[grasp.contact, :size] += np.linalg.lstsq(place[:size].T, joint, rcond=None)[0]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of rows (n, 3); NumPy's takes longer than a physics step."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _sizes(world: World) -> np.ndarray:
    """Units (nv,) of positions: the reach for translations, a radian for rotations."""
    sizes = np.ones(world.compiled.nv)
    kinds = mujoco_package().mjtJoint
    slide, free = int(kinds.mjJNT_SLIDE), int(kinds.mjJNT_FREE)  # `in` finds no enum for NumPy's integers
    for joint in range(world.compiled.njnt):
        kind, row = int(world.compiled.jnt_type[joint]), int(world.compiled.jnt_dofadr[joint])
        if kind in (slide, free):
            sizes[row : row + (3 if kind == free else 1)] = world.units.length
    return sizes


# Seeds the sensor noise apart from the initial noise, which uses the seed alone.
SENSORS = 1


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Sensor readings at a tick: qpos (nq',), qvel (nv,) in MuJoCo's coordinates, touching (nc,)."""

    qpos: np.ndarray
    qvel: np.ndarray
    touching: np.ndarray


class Hardware:
    """Sensors and drives of one simulation, with their memory.

    Args:
        model: MuJoCo's, compiled.
        settings: of the simulation.
        units: (nv,) of positions; rates are in these over ``time``.
        time: natural time, s.
        period: of the controller, s.
        torque: (nu,) before the first tick.
    """

    def __init__(
        self,
        model: Any,
        settings: SimulationSettings,
        *,
        units: np.ndarray,
        time: float,
        period: float,
        torque: np.ndarray,
    ) -> None:
        self._model, self._settings = model, settings
        self._units, self._time, self._most = units, time, settings.torque_rate * period
        self._generator = np.random.default_rng((settings.seed, SENSORS))
        self._history: deque[Measurement] = deque(maxlen=settings.delay + 1)
        self._torque = torque.copy()

    def copy(self) -> Hardware:
        """A copy that continues in the same way, with the same random numbers."""
        duplicate = copy.copy(self)
        duplicate._generator, duplicate._history = copy.deepcopy(self._generator), self._history.copy()
        return duplicate

    def measure(self, qpos: np.ndarray, qvel: np.ndarray, touching: np.ndarray) -> Measurement:
        """Measure a state; returns the reading of ``delay`` ticks ago, or the first, for the controller."""
        measurement = Measurement(qpos=qpos.copy(), qvel=qvel.copy(), touching=touching)
        if self._settings.sensor_noise:
            size = self._settings.sensor_noise * self._units
            error = size * self._generator.standard_normal(self._model.nv)
            mujoco_package().mj_integratePos(self._model, measurement.qpos, error, 1.0)
            measurement.qvel[:] += size * self._generator.standard_normal(self._model.nv) / self._time
        self._history.append(measurement)
        return self._history[0]

    def command(self, wanted: np.ndarray) -> np.ndarray:
        """Torques (nu,) for a command: rounded, and limited in their change from the last ones."""
        torque, step = wanted, self._settings.torque_step
        if step:
            torque = step * np.round(torque / step)
        if self._most:
            torque = np.clip(torque, self._torque - self._most, self._torque + self._most)
        return torque

    def deliver(self, torque: np.ndarray) -> None:
        """Store the torques (nu,) of a tick, after clipping."""
        self._torque = torque

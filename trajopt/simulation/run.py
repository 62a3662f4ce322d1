"""The simulation itself: a scene, a controller and events produce a record, tick by tick.

At the start of each tick the controller returns torques for the measured state. They are clipped at the
limits of the drives, and act for the whole period. Sensors and drives may be those of real hardware.
"""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import dataclass

import numpy as np

from trajopt.control.limits import limits_with_drives
from trajopt.control.reference import ContactTimeline
from trajopt.control.tracker import Tracker
from trajopt.errors import InputError
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.events import Events
from trajopt.simulation.record import RequestRecord, SimulationRecord
from trajopt.simulation.scene import Scene
from trajopt.simulation.settings import SimulationSettings, TorqueController

# Most physics steps of one simulation: minutes.
MOST_STEPS = 20_000_000
# A contact touches if its force is above this fraction of the weight.
TOUCHING = 1e-3
# Seeds the sensor noise apart from the initial noise, which uses the seed alone.
SENSORS = 1


@dataclass(frozen=True, kw_only=True)
class Start:
    """The state from which a simulation starts.

    Args:
        q: configuration (nq,), Pinocchio's.
        v: velocity (nv,).
        torque: torques (nu,) of the drives before the first tick.
    """

    q: np.ndarray
    v: np.ndarray
    torque: np.ndarray


class SimulationRun:
    """One simulation: from start to end by `record`, or of some ticks by `advance`.

    Args:
        scene: the scene.
        timeline: the ticks.
        controller: returns the torques of each tick.
        start: the initial state.
        settings: settings of steps, hardware and events.

    Attributes:
        forgotten: number of ticks before the first row of the record.
    """

    def __init__(
        self,
        scene: Scene,
        timeline: ContactTimeline,
        controller: TorqueController,
        start: Start,
        settings: SimulationSettings,
    ) -> None:
        self.mujoco, self.scene, self.timeline = mujoco_package(), scene, timeline
        self.controller, self.settings, self.model = controller, settings, scene.compiled
        self.data = self.mujoco.MjData(self.model)
        self.substeps = max(1, int(np.ceil(timeline.period / settings.step(scene.units.time) - 1e-9)))
        if self.substeps * len(timeline.t) > MOST_STEPS:
            steps = f"{self.substeps * len(timeline.t):.3g}"
            raise InputError(f"a simulation of {steps} steps", f"allowed: {MOST_STEPS}; a longer timestep")
        self.model.opt.timestep = timeline.period / self.substeps
        self.rows, self.forgotten = scene.rows, 0
        self.touching = timeline.active[0]
        self.events = Events(scene, timeline, settings)
        qpos = scene.coordinates.to_mujoco(start.q[None])
        self.data.qpos[:] = qpos[0]
        self.data.qvel[:] = scene.coordinates.rates_to_mujoco(qpos, start.v[None])[0]
        self.hardware = Hardware(scene, settings, timeline.period, self._in_mujoco(qpos, start.torque))

    def _in_mujoco(self, qpos: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Convert inputs (nu,) at ``qpos`` (1, nq') to MuJoCo's coordinates: joint torques along its axes."""
        joints, robot = len(self.rows), self.scene.robot
        whole = np.zeros((1, robot.model.nv))
        whole[0, robot.actuated_rows] = torque[:joints]
        moved = self.scene.coordinates.rates_to_mujoco(qpos, whole)[0, self.rows]
        return np.append(moved, torque[joints:])

    def record(self) -> SimulationRecord:
        """Simulate all ticks from the start."""
        record = self.start()
        return self.ended(record, self.advance(record, 0, len(self.timeline.t)))

    def ended(self, record: SimulationRecord, reached: int) -> SimulationRecord:
        """Complete the record with the final state; if it diverged, cut it by `SimulationRecord.until`."""
        if reached < len(self.timeline.t):
            return record.until(reached)
        record.qpos[reached], record.qvel[reached] = self.data.qpos, self.data.qvel
        return record

    def start(self) -> SimulationRecord:
        """Add the initial noise of the settings; returns a record for all ticks with the initial state."""
        self._disturb()
        count, contacts, model = len(self.timeline.t), len(self.scene.sites), self.model
        nu, tracker = self.scene.robot.nu, self.controller if isinstance(self.controller, Tracker) else None
        record = SimulationRecord(
            qpos=np.zeros((count + 1, model.nq)),
            qvel=np.zeros((count + 1, model.nv)),
            qacc=np.zeros((count, model.nv)),
            torque=np.zeros((count, nu)),
            saturated=np.zeros((count, nu), dtype=bool),
            friction=np.zeros((count, nu)),
            force=np.zeros((count, contacts, 6)),
            feet=np.zeros((count, contacts, 3)),
            turns=np.zeros((count, contacts, 3, 3)),
            touched=np.zeros(count, dtype=bool),
            hit=np.zeros(count, dtype=bool),
            counts=None if tracker is None else tracker.counts,
            requests=None if tracker is None else RequestRecord.empty(count, contacts),
        )
        record.qpos[0], record.qvel[0] = self.data.qpos, self.data.qvel
        return record

    def branch(self) -> SimulationRun:
        """A copy that continues from here; as they share models, only one run at a time may advance."""
        branched = copy.copy(self)
        branched.data, branched.hardware = copy.copy(self.data), self.hardware.copy()
        branched.events = copy.copy(self.events)
        if isinstance(self.controller, Tracker):
            branched.controller = self.controller.copy()
        return branched

    def advance(self, record: SimulationRecord, begin: int, end: int) -> int:
        """Simulate rows ``begin`` to before ``end``; returns ``end``, or where the simulation diverged."""
        model, data, scene = self.model, self.data, self.scene
        record.force[begin:end] = 0.0  # forces are accumulated
        least = TOUCHING * scene.units.weight
        for k in range(begin, end):
            self.events.apply(self.forgotten + k, data, anew=k == begin)
            record.qpos[k], record.qvel[k] = data.qpos, data.qvel
            if not np.isfinite(data.qpos).all() or not np.isfinite(data.qvel).all():
                return k
            record.torque[k], record.saturated[k] = self._drive(self.forgotten + k)
            if isinstance(self.controller, Tracker) and record.requests is not None:
                record.requests.note(k, self.controller.request)
            self.mujoco.mj_forward(model, data)  # forces of this state: a step leaves those of its stages
            if not self._is_sane():
                return k
            record.qacc[k], record.friction[k] = data.qacc, self._friction()
            record.feet[k] = data.site_xpos[scene.sites]
            record.turns[k] = data.site_xmat[scene.sites].reshape(-1, 3, 3)
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

    def _disturb(self) -> None:
        """Add the initial noise to the state."""
        if self.settings.noise:
            generator = np.random.default_rng(self.settings.seed)
            size = self.settings.noise * units_of(self.scene)
            error = size * generator.standard_normal(self.model.nv)
            self.mujoco.mj_integratePos(self.model, self.data.qpos, error, 1.0)
            self.data.qvel[:] += size * generator.standard_normal(self.model.nv) / self.scene.units.time

    def _drive(self, tick: int) -> tuple[np.ndarray, np.ndarray]:
        """Apply the torques of a tick; returns them, and where they were clipped."""
        robot, coordinates = self.scene.robot, self.scene.coordinates
        measured = self.hardware.measure(self.data.qpos, self.data.qvel, self.touching)
        qpos = measured.qpos[None]
        q, v = coordinates.from_mujoco(qpos)[0], coordinates.rates_from_mujoco(qpos, measured.qvel[None])[0]
        wanted = self.controller.torque(tick * self.timeline.period, q, v, measured.touching)
        wanted = self.hardware.command(self._in_mujoco(qpos, wanted))
        low, high = robot.limits
        if any(drive is not None for drive in robot.drives):
            low, high = limits_with_drives(robot.drives, self.data.qvel[self.rows], low, high)
        torque = np.clip(wanted, low, high)
        self.hardware.deliver(torque)
        joints = len(self.rows)
        if joints < len(torque):
            thrust = robot.actuation.thrust @ torque[joints:]
            pushed = coordinates.rates_to_mujoco(self.data.qpos[None], thrust[None])
            self.data.qfrc_applied[:] = pushed[0]
        self.data.qfrc_applied[self.rows] = torque[:joints]
        return torque, torque != wanted

    def _friction(self) -> np.ndarray:
        """Friction torques (nu,) of the drives on their joints: viscous, and Coulomb's as a constraint."""
        whole = self.data.qfrc_passive.copy()
        is_friction = self.data.efc_type == self.mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
        np.add.at(whole, self.data.efc_id[is_friction], self.data.efc_force[is_friction])
        return np.append(whole[self.rows], np.zeros(self.scene.robot.nu - len(self.rows)))

    def _contacts(self, force: np.ndarray, feet: np.ndarray) -> tuple[bool, bool]:
        """Add contact wrenches to ``force`` (nc, 6); returns whether a link touches ground, and an obstacle.

        A link that touches the ground next to a foot does not count.
        """
        touching, scene = self.data.contact, self.scene
        loaded = touching.efc_address >= 0
        geoms = touching.geom[loaded]
        if len(geoms):
            push, owner = self._pushes(loaded), scene.contact_of[geoms].max(axis=1, initial=-1)
            # MuJoCo's forces act on the second geom of a pair.
            push *= np.where(scene.contact_of[geoms[:, 0]] >= 0, -1.0, 1.0)[:, None]
            arm = touching.pos[loaded] - feet[owner] if len(feet) else np.zeros_like(push)
            wrench = np.column_stack([push, _cross(arm, push)])[owner >= 0]
            np.add.at(force, owner[owner >= 0], wrench)
        self._grasped(force)
        links = scene.links[geoms].any(axis=1)
        apart = np.linalg.norm(touching.pos[loaded][links][:, None] - feet, axis=2)
        fallen = (apart > scene.feet).all(axis=1)
        return bool(fallen.any()), bool(scene.obstacles[geoms].any())

    def _pushes(self, loaded: np.ndarray) -> np.ndarray:
        """Contact forces (n, 3) in world axes; contacts without friction have only a normal force."""
        touching = self.data.contact
        rows = touching.efc_address[loaded][:, None] + np.arange(3)
        forces = self.data.efc_force[np.minimum(rows, self.data.nefc - 1)]
        forces = np.where(np.arange(3) < touching.dim[loaded][:, None], forces, 0.0)
        return np.einsum("ni,nij->nj", forces, touching.frame[loaded].reshape(-1, 3, 3))

    def _grasped(self, force: np.ndarray) -> None:
        """Add the wrenches of grasp constraints: those with the same effect on the joints."""
        for grasp in self.scene.site.grasps:
            number = self.model.equality(grasp.name).id
            if self.data.eq_active[number]:
                holding = (self.data.efc_type == self.mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (
                    self.data.efc_id == number
                )
                rows = self.data.efc_J.reshape(-1, self.model.nv)[holding]
                joint = rows.T @ self.data.efc_force[holding]
                site = self.scene.sites[grasp.contact]
                place = np.zeros((6, self.model.nv))
                self.mujoco.mj_jacSite(self.model, self.data, place[:3], place[3:], site)
                size = 6 if grasp.turns else 3
                force[grasp.contact, :size] += np.linalg.lstsq(place[:size].T, joint, rcond=None)[0]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of rows (n, 3); NumPy's takes longer than a physics step."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Sensor readings at a tick: qpos (nq',), qvel (nv,) in MuJoCo's coordinates, touching (nc,)."""

    qpos: np.ndarray
    qvel: np.ndarray
    touching: np.ndarray


class Hardware:
    """Sensors and drives of one simulation, with their memory.

    Args:
        scene: the scene.
        settings: settings of the simulation.
        period: period of the controller, s.
        torque: torques (nu,) before the first tick.
    """

    def __init__(self, scene: Scene, settings: SimulationSettings, period: float, torque: np.ndarray) -> None:
        self._model, self._settings = scene.compiled, settings
        self._units, self._time = units_of(scene), scene.units.time
        self._most = settings.torque_rate * period
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


def units_of(scene: Scene) -> np.ndarray:
    """Units (nv,) of positions: the reach for translations, a radian for rotations."""
    sizes = np.ones(scene.compiled.nv)
    kinds = mujoco_package().mjtJoint
    slide, free = int(kinds.mjJNT_SLIDE), int(kinds.mjJNT_FREE)  # `in` finds no enum for NumPy's integers
    for joint in range(scene.compiled.njnt):
        kind, row = int(scene.compiled.jnt_type[joint]), int(scene.compiled.jnt_dofadr[joint])
        if kind in (slide, free):
            sizes[row : row + (3 if kind == free else 1)] = scene.units.length
    return sizes

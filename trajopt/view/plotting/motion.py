"""Plotted quantities of a motion at its samples, by numeric Pinocchio: momentum, base, contact forces."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.collision.near import GROUND
from trajopt.dynamics.base_joint import BASE_JOINT
from trajopt.dynamics.virtual_base import angles_of
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.samples import payload_wrenches
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.on_robot import drive_torque_values
from trajopt.robot.contact import centre_of_pressure
from trajopt.view.replay.motion import LEAST_PRESSURE

# Maps model, data, q and v to an array.
_State = Callable[[pin.Model, pin.Data, np.ndarray, np.ndarray], np.ndarray]
YAW_PITCH_ROLL = "ZYX"


class PlottedMotion(MotionQuantities):
    """Quantities at the K samples of a solution that only plots need; NaN where q or v is not finite.

    Vectors of forces, momenta and the base are in world axes, SI units.
    """

    @cached_property
    def finite(self) -> np.ndarray:
        """Samples (K,) whose q and v are finite."""
        return np.isfinite(self.solution.q).all(axis=1) & np.isfinite(self.solution.v).all(axis=1)

    @property
    def t(self) -> np.ndarray:
        """Times (K,) s."""
        return self.solution.t

    @cached_property
    def drives(self) -> tuple[Drive | None, ...]:
        """The drive of every actuated row, empty if the robot has none."""
        return self.solution.description.drives

    @cached_property
    def drive_torque(self) -> np.ndarray:
        """Torques (K, nu) of the drives on the joint side: those of the actuated rows plus joint friction."""
        if not self.drives:
            return self.solution.tau
        return drive_torque_values(self.drives, self.solution.tau, self.rates)

    @property
    def rates(self) -> np.ndarray:
        """Rates (K, nu) of the actuated rows."""
        return self.solution.actuation.rates(self.solution.v)

    @cached_property
    def power(self) -> np.ndarray:
        """Mechanical power (K, nu) W of the actuated rows: torque of the drive times rate."""
        return self.drive_torque * self.rates

    @cached_property
    def centre(self) -> np.ndarray:
        """Centre of mass (K, 3) m."""
        return self._rows(3, lambda model, data, q, v: pin.centerOfMass(model, data, q, False))

    @cached_property
    def momentum(self) -> np.ndarray:
        """Linear and, about the centre of mass, angular momentum (K, 6), kg m/s and kg m^2/s."""
        return self._rows(
            6, lambda model, data, q, v: pin.computeCentroidalMomentum(model, data, q, v).vector
        )

    @cached_property
    def base_position(self) -> np.ndarray:
        """Position (K, 3) m of the base."""
        return self._base[:, :3, 3]

    @cached_property
    def base_angles(self) -> np.ndarray:
        """Roll, pitch and yaw (K, 3) rad of the base, R = R_z(yaw) R_y(pitch) R_x(roll), without jumps."""
        angles, near = np.full((len(self.t), 3), np.nan), None
        for row in np.flatnonzero(self.finite):
            near = angles_of(YAW_PITCH_ROLL, self._base[row, :3, :3], near)
            angles[row] = near[::-1]
        return angles

    @cached_property
    def base_twist(self) -> np.ndarray:
        """Velocity of the base's origin and its angular velocity (K, 6), m/s and rad/s."""
        joint = BASE_JOINT[self.base]

        def twist(model: pin.Model, data: pin.Data, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            pin.forwardKinematics(model, data, q, v)
            return np.asarray(pin.getVelocity(model, data, joint, pin.LOCAL_WORLD_ALIGNED).vector)

        return self._rows(6, twist)

    @cached_property
    def _base(self) -> np.ndarray:
        """Placements (K, 4, 4) of the base; for a planar joint without the rotation of its plane."""
        model, kind = self.solution.model, self.base
        joint = BASE_JOINT[kind]
        turn = model.jointPlacements[joint].rotation.T if kind == "planar" else np.eye(3)

        def placement(model: pin.Model, data: pin.Data, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            pin.forwardKinematics(model, data, q)
            return np.asarray((data.oMi[joint] * pin.SE3(turn, np.zeros(3))).homogeneous).ravel()

        return self._rows(16, placement).reshape(-1, 4, 4)

    def _rows(self, size: int, of: _State) -> np.ndarray:
        model, data = self.solution.model, self.solution.model.createData()
        rows = np.full((len(self.t), size), np.nan)
        for row in np.flatnonzero(self.finite):
            rows[row] = of(model, data, self.solution.q[row], self.solution.v[row])
        return rows

    @cached_property
    def force(self) -> np.ndarray:
        """Forces (K, nc, 3) N on active contacts, NaN on others."""
        return np.where(self.solution.active[..., None], self.solution.f[..., :3], np.nan)

    @cached_property
    def normal(self) -> np.ndarray:
        """Normal forces (K, nc) N."""
        return self.surfaces.along_normal(self.force)

    @cached_property
    def tangential(self) -> np.ndarray:
        """Magnitude (K, nc) N of the tangential forces."""
        along = self.force - self.normal[..., None] * self.surfaces.normal
        return np.asarray(np.linalg.norm(along, axis=-1))

    @cached_property
    def cone(self) -> np.ndarray:
        """Radius mu f_n (K, nc) N of the friction cone; NaN on a bilateral surface, which has none."""
        return np.where(self.surfaces.bilateral, np.nan, self.surfaces.friction * self.normal)

    @cached_property
    def cone_share(self) -> np.ndarray:
        """Tangential force over the cone's radius (K, nc); NaN without pressure."""
        pressed = self.normal > LEAST_PRESSURE * self.units.weight
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(pressed, self.tangential / self.cone, np.nan)

    @cached_property
    def load(self) -> np.ndarray:
        """Magnitude (K,) N of the force of carried bodies on the robot, zero where nothing is carried."""
        carried = payload_wrenches(self.solution)[..., :3].sum(axis=1)
        return np.asarray(np.linalg.norm(carried, axis=-1))

    @cached_property
    def pressure_centre(self) -> np.ndarray:
        """Centres of pressure (K, nc, 2) m in the axes of the soles; NaN for points and without pressure."""
        to_sole = np.swapaxes(self.samples.rotation, -1, -2)
        force, moment = (
            np.einsum("kcij,kcj->kci", to_sole, part)
            for part in (self.solution.f[..., :3], self.solution.f[..., 3:])
        )
        pressed = self.solution.active & self.solution.description.soles & ~self.surfaces.bilateral
        pressed &= force[..., 2] > LEAST_PRESSURE * self.units.weight
        centre = centre_of_pressure(force, moment, np.array([0.0, 0.0, 1.0]))[..., :2]
        return np.where(pressed[..., None], centre, np.nan)

    @cached_property
    def clearances(self) -> dict[str, np.ndarray]:
        """Least signed distance (K,) m by name: to each obstacle, to "ground", and of links to "itself".

        Distances are between the shapes of the links, or between capsules in files without these shapes.
        """
        model, plan = self.solution.model, self.solution.description
        given = plan.capsule_scene(model)
        scene = None if given is None else plan.body_scene(model) or given
        if scene is None or not scene.pairs:
            return {}
        distances = np.full((len(self.t), len(scene.pairs)), np.nan)
        distances[self.finite] = scene.distances(self.solution.q[self.finite])
        if plan.bodies is not None:
            distances[~plan.bodies.present(scene.pairs, self.solution.phase)] = np.inf
        names = (GROUND, *(obstacle.name for obstacle in scene.obstacles), "itself")
        columns: dict[str, list[int]] = {name: [] for name in names}
        for i, pair in enumerate(scene.pairs):
            columns[pair[1] if i < scene.n_outer else "itself"].append(i)
        return {name: distances[:, index].min(axis=1) for name, index in columns.items() if index}

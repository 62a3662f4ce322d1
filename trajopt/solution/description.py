"""What a solution is of: contacts, limits, ground, goals, loads and shapes, as frozen records."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from trajopt.collision.description import RobotShapes
from trajopt.collision.near import CollisionScene
from trajopt.collision.shapes import LinkShape, Obstacle
from trajopt.robot.actuators.actuation import Thruster
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.joint_force import JointForce
from trajopt.robot.actuators.mimic import MimicJoint
from trajopt.robot.data import VisualSource
from trajopt.schedule.moment import Target
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import Terrain

ContactKind = Literal["point", "surface"]
GroundShape = Surface | PiecewiseTerrain | SmoothTerrain


@dataclass(frozen=True, kw_only=True)
class PlannedContact:
    """A contact of the robot that was planned for.

    Attributes:
        name: of the contact.
        frame: of the model, at its origin the contact acts.
        kind: "point", or "surface" for a sole.
        friction: coefficient on the terrain.
        half_size: half length and half width of a sole, m; None of a point, and where it is not known.
        radius: of the ball around a point, m; the frame is its centre.
        rolling: whether the ball rolls on what it touches.
    """

    name: str
    frame: str
    kind: ContactKind
    friction: float
    half_size: tuple[float, float] | None = None
    radius: float = 0.0
    rolling: bool = False

    @property
    def is_sole(self) -> bool:
        """Whether it transmits moments."""
        return self.kind == "surface"


@dataclass(frozen=True, kw_only=True, eq=False)
class CarriedBody:
    """A body that the robot carries: mass kg, centre (3,) m, inertia (3, 3) kg m^2 in a contact frame's axes.

    phases: indices of the phases in which it is carried.
    """

    frame: str
    mass: float
    centre: np.ndarray
    inertia: np.ndarray
    phases: tuple[int, ...]

    @property
    def spatial(self) -> pin.Inertia:
        """Spatial inertia in the frame's axes, about its origin."""
        return pin.Inertia(float(self.mass), np.array(self.centre), np.array(self.inertia))


@dataclass(frozen=True, kw_only=True, eq=False)
class PeriodicImage:
    """The image that the last state of a periodic plan is of the first, see `trajopt.problem.periodicity`.

    Attributes:
        index, sign: (nv,) for each row of v the row that it comes from, and its sign.
        translation: m, or velocity: m/s times the duration, (3,) in the world.
        turn: about the vertical through origin (3,) m, rad.
        mirror: in the vertical plane y = origin.
    """

    index: np.ndarray
    sign: np.ndarray
    origin: np.ndarray
    translation: tuple[float, ...] | None = None
    velocity: tuple[float, ...] | None = None
    turn: float = 0.0
    mirror: bool = False

    def moved(self, duration: float) -> np.ndarray:
        """Translation (3,) m over a duration in s."""
        if self.velocity is not None:
            return np.array(self.velocity) * duration
        return np.zeros(3) if self.translation is None else np.array(self.translation)


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyMargins:
    """Least distances that were asked for: from obstacles m, and between pairs of links (n_pairs,) m."""

    obstacles: float
    pairs: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanDescription:
    """What a plan is of, read once from a file or made once from a problem. nu actuated rows, nc contacts.

    Attributes:
        problem, robot: names.
        parameters: of the problem's family, JSON-able.
        contacts: (nc,) in the order of forces.
        actuation: the control input, "torque", "acceleration" or "velocity".
        gravity: (3,) m/s^2.
        effort_limit: (nu,) N m or N, infinite where there is none; None without any.
        velocity_limit: (nv,) rad/s or m/s, likewise.
        actuated_rows: rows of v that have a torque; None where they are the last.
        thrusters: whose forces are the last columns of torques.
        joint_forces: springs, damping and dry friction at joints, part of the dynamics.
        mimics: joints that follow others.
        terrain: None where it is not known.
        surfaces, patches: for each phase what active contacts touch or stand on, by contact frames; empty
            where all touch the terrain.
        goals: targets of the problem.
        payloads: bodies that are carried.
        periodicity: None of a plan that does not repeat.
        drives: (nu,) of the actuated rows, None without; empty without any.
        bodies: shapes of the robot's links; None where they are not known.
        margins: least distances of the bodies; None: they may touch.
        obstacles: in the scene.
        capsules, capsule_pairs: a scene of links of older files, and pairs of them that must stay apart.
        visual: where meshes of the robot are.
        phase_names: of every phase.
    """

    problem: str
    robot: str
    contacts: tuple[PlannedContact, ...]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    actuation: str = "torque"
    gravity: tuple[float, ...] | None = None
    effort_limit: np.ndarray | None = None
    velocity_limit: np.ndarray | None = None
    actuated_rows: np.ndarray | None = None
    thrusters: tuple[Thruster, ...] = ()
    joint_forces: tuple[JointForce, ...] = ()
    mimics: tuple[MimicJoint, ...] = ()
    terrain: Terrain | None = None
    surfaces: tuple[Mapping[str, Surface], ...] = ()
    patches: tuple[Mapping[str, Patch], ...] = ()
    goals: tuple[Target, ...] = ()
    payloads: tuple[CarriedBody, ...] = ()
    periodicity: PeriodicImage | None = None
    drives: tuple[Drive | None, ...] = ()
    bodies: RobotShapes | None = None
    margins: BodyMargins | None = None
    obstacles: tuple[Obstacle, ...] = ()
    capsules: tuple[LinkShape, ...] = ()
    capsule_pairs: tuple[tuple[str, str], ...] = ()
    visual: VisualSource | None = None
    phase_names: tuple[str, ...]

    @property
    def ground(self) -> GroundShape | None:
        """The terrain, flat ground as its plane."""
        return self.terrain.surface if isinstance(self.terrain, FlatGround) else self.terrain

    @property
    def frames(self) -> tuple[str, ...]:
        """Frame of each contact."""
        return tuple(contact.frame for contact in self.contacts)

    @property
    def soles(self) -> np.ndarray:
        """Which contacts are soles (nc,)."""
        return np.array([contact.is_sole for contact in self.contacts], dtype=bool)

    @property
    def radii(self) -> np.ndarray:
        """Radii of the contacts (nc,), m."""
        return np.array([contact.radius for contact in self.contacts], dtype=float)

    @property
    def rolling(self) -> np.ndarray:
        """Which contacts roll (nc,)."""
        return np.array([contact.rolling for contact in self.contacts], dtype=bool)

    @property
    def velocity_input(self) -> bool:
        """Whether rates are the control input: rows are of statics and of velocities, not of motion."""
        return self.actuation == "velocity"

    def carried_in(self, phase: int) -> list[CarriedBody]:
        """Bodies that are carried in a phase."""
        return [body for body in self.payloads if phase in body.phases]

    def body_scene(self, model: pin.Model) -> CollisionScene | None:
        """Scene of the links' shapes, the obstacles and the terrain; None without shapes."""
        if self.bodies is None or not self.bodies.shapes:
            return None
        return self.bodies.scene(model, self.terrain, self.obstacles)

    def capsule_scene(self, model: pin.Model) -> CollisionScene | None:
        """Scene of obstacles and of the capsules of older files; None without obstacles and capsules."""
        if not (self.obstacles or self.capsules):
            return None
        return CollisionScene(
            model=model, shapes=self.capsules, obstacles=self.obstacles, self_pairs=self.capsule_pairs
        )

    def body_margins(self, scene: CollisionScene) -> np.ndarray:
        """Least distance (n_pairs,) m of each pair of `body_scene`; zero: no contact."""
        margins = np.zeros(len(scene.pairs))
        if self.margins is not None:
            margins[scene.n_ground : scene.n_outer] = self.margins.obstacles
            margins[scene.n_outer :] = self.margins.pairs
        return margins

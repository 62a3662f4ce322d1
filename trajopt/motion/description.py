"""Description of a plan as frozen records: contacts, limits, ground, goals, payloads and shapes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from trajopt.arguments import Array3, Array33, NonNegative, checked
from trajopt.collision.description import RobotShapes
from trajopt.collision.near import CollisionScene
from trajopt.collision.shapes import LinkShape, Obstacle
from trajopt.errors import InputError
from trajopt.robot.actuators.actuation import Thruster
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.joint_force import JointForce
from trajopt.robot.actuators.joint_limits import JointLimits
from trajopt.robot.actuators.mimic import MimicJoint
from trajopt.robot.data import VisualSource
from trajopt.robot.link_wrench import LinkWrench
from trajopt.robot.payload import require_rigid
from trajopt.schedule.moment import Target
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import Terrain

ContactKind = Literal["point", "surface"]
# What the dynamics of a problem are: those that hold contacts in place; whole-body dynamics with rows of the
# problem's own in their place; or the problem's own, as of a reduced model.
DynamicsKind = Literal["held", "forced", "own"]
GroundShape = Surface | PiecewiseTerrain | SmoothTerrain


@checked
@dataclass(frozen=True, kw_only=True)
class PlannedContact:
    """A contact of the robot for which the motion was planned.

    Attributes:
        name: Name of the contact.
        frame: Frame of the model at whose origin the contact acts.
        kind: "point", or "surface" for a sole.
        friction: Friction coefficient on the terrain.
        half_size: Half length and half width of a sole, m; None for a point, and if unknown.
        radius: Radius of the ball around a point, m; the frame is its centre.
        rolling: Whether the ball rolls on its surface.
    """

    name: str
    frame: str
    kind: ContactKind
    friction: NonNegative
    half_size: tuple[float, float] | None = None
    radius: NonNegative = 0.0
    rolling: bool = False

    def __post_init__(self) -> None:
        if self.radius and self.is_sole:
            raise InputError(f"sole '{self.name}' has a radius", "allowed: 0")
        if self.rolling and not self.radius:
            raise InputError(f"contact '{self.name}' is rolling without a radius", "allowed: a radius")

    @property
    def is_sole(self) -> bool:
        """Whether the contact transmits moments."""
        return self.kind == "surface"


# Control inputs by which a motion has torques.
TORQUE_INPUTS = ("torque", "jerk")


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class CarriedBody:
    """A carried body: mass kg, centre (3,) m and inertia (3, 3) kg m^2 in a contact frame's axes.

    phases: indices of the phases in which the robot carries it.
    """

    frame: str
    mass: NonNegative
    centre: Array3
    inertia: Array33
    phases: tuple[int, ...]

    def __post_init__(self) -> None:
        require_rigid(self.inertia)

    @property
    def spatial(self) -> pin.Inertia:
        """Spatial inertia about the frame's origin, in its axes."""
        return pin.Inertia(float(self.mass), self.centre, self.inertia)


@dataclass(frozen=True, kw_only=True, eq=False)
class PeriodicImage:
    """The map from the first state of a periodic plan to the last, see `trajopt.problem.periodicity`.

    Attributes:
        index, sign: (nv,) the row of v that each row is the image of, and its sign.
        origin: (3,) m, world.
        translation, velocity: (3,) world; a displacement in m, or a velocity in m/s times the duration.
        turn: Rotation about the vertical through the origin, rad.
        mirror: Whether it reflects in the vertical plane y = origin.
    """

    index: np.ndarray
    sign: np.ndarray
    origin: np.ndarray
    translation: tuple[float, ...] | None = None
    velocity: tuple[float, ...] | None = None
    turn: float = 0.0
    mirror: bool = False

    def moved(self, duration: float) -> np.ndarray:
        """Return the translation (3,) m over a duration in s."""
        if self.velocity is not None:
            return np.array(self.velocity) * duration
        return np.zeros(3) if self.translation is None else np.array(self.translation)


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyMargins:
    """Required distances: from obstacles, m, and between pairs of links (n_pairs,), m."""

    obstacles: float
    pairs: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanDescription:
    """Description of a plan with nu actuated rows and nc contacts, from a file or a problem.

    Attributes:
        problem, robot: Names.
        parameters: Parameters of the problem's family, JSON-able.
        contacts: (nc,) in the order of the forces.
        actuation: Control input, "torque", "acceleration", "velocity" or "jerk".
        dynamics: "held" if contacts stay in place; "forced" if rows of the problem's own move them and the
            planned forces act; "own" for dynamics of which the check knows nothing.
        gravity: (3,) m/s^2.
        effort_limit: (nu,) N m or N, infinite where unlimited; None without limits.
        velocity_limit: (nv,) rad/s or m/s, likewise.
        actuated_rows: Rows of v with a torque; None if they are the last ones.
        thrusters: Thrusters; their forces are the last columns of the torques.
        joint_forces: Springs, damping and dry friction at joints; part of the dynamics.
        mimics: Joints that follow others.
        joint_limits: Limits of accelerations, jerks and torque rates.
        terrain: None if unknown.
        surfaces, patches: For each phase, what active contacts touch or stand on, by contact frame; empty if
            all touch the terrain.
        goals: Targets of the problem.
        payloads: Carried bodies.
        wrenches: Known wrenches on links over time; part of the dynamics.
        periodicity: None if the plan is not periodic.
        drives: (nu,) drives of the actuated rows, None for rows without one; empty without drives.
        bodies: Shapes of the robot's links; None if unknown.
        margins: Required distances of the bodies; None if they may touch.
        obstacles: Obstacles in the scene.
        capsules, capsule_pairs: Link shapes of older files, and pairs of them that must stay apart.
        visual: Source of the robot's meshes.
        phase_names: Names of the phases.
    """

    problem: str
    robot: str
    contacts: tuple[PlannedContact, ...]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    actuation: str = "torque"
    dynamics: DynamicsKind = "held"
    gravity: tuple[float, ...] | None = None
    effort_limit: np.ndarray | None = None
    velocity_limit: np.ndarray | None = None
    actuated_rows: np.ndarray | None = None
    thrusters: tuple[Thruster, ...] = ()
    joint_forces: tuple[JointForce, ...] = ()
    mimics: tuple[MimicJoint, ...] = ()
    joint_limits: tuple[JointLimits, ...] = ()
    terrain: Terrain | None = None
    surfaces: tuple[Mapping[str, Surface], ...] = ()
    patches: tuple[Mapping[str, Patch], ...] = ()
    goals: tuple[Target, ...] = ()
    payloads: tuple[CarriedBody, ...] = ()
    wrenches: tuple[LinkWrench, ...] = ()
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
        """The terrain; flat ground as a plane."""
        return self.terrain.surface if isinstance(self.terrain, FlatGround) else self.terrain

    @property
    def separate_surfaces(self) -> list[tuple[int, int, Surface]]:
        """(phase, contact, surface) of contacts that hold a surface, or touch one beside the terrain."""
        ground = self.ground
        faces = ground.faces if isinstance(ground, PiecewiseTerrain) else ()
        planes = [ground] if isinstance(ground, Surface) else [face.surface for face in faces]
        return [
            (phase, self.frames.index(frame), surface)
            for phase, surfaces in enumerate(self.surfaces)
            for frame, surface in surfaces.items()
            if surface.bilateral or not any(surface.same_plane(plane) for plane in planes)
        ]

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames of the contacts."""
        return tuple(contact.frame for contact in self.contacts)

    @property
    def soles(self) -> np.ndarray:
        """Whether each contact is a sole (nc,)."""
        return np.array([contact.is_sole for contact in self.contacts], dtype=bool)

    @property
    def radii(self) -> np.ndarray:
        """Radii of the contacts (nc,), m."""
        return np.array([contact.radius for contact in self.contacts], dtype=float)

    @property
    def rolling(self) -> np.ndarray:
        """Whether each contact rolls (nc,)."""
        return np.array([contact.rolling for contact in self.contacts], dtype=bool)

    @property
    def velocity_input(self) -> bool:
        """Whether rates are the control input; the rows are then statics and velocities."""
        return self.actuation == "velocity"

    def carried_in(self, phase: int) -> list[CarriedBody]:
        """Return the bodies that are carried in a phase."""
        return [body for body in self.payloads if phase in body.phases]

    def body_scene(self, model: pin.Model) -> CollisionScene | None:
        """Return the scene of the link shapes, obstacles and terrain; None without shapes."""
        if self.bodies is None or not self.bodies.shapes:
            return None
        return self.bodies.scene(model, self.terrain, self.obstacles)

    def capsule_scene(self, model: pin.Model) -> CollisionScene | None:
        """Return the scene of obstacles and older files' capsules; None without both."""
        if not (self.obstacles or self.capsules):
            return None
        return CollisionScene(
            model=model, shapes=self.capsules, obstacles=self.obstacles, self_pairs=self.capsule_pairs
        )

    def body_margins(self, scene: CollisionScene) -> np.ndarray:
        """Return the required distance (n_pairs,) m of each pair of `body_scene`; zero means no contact."""
        margins = np.zeros(len(scene.pairs))
        if self.margins is not None:
            margins[scene.n_ground : scene.n_outer] = self.margins.obstacles
            margins[scene.n_outer :] = self.margins.pairs
        if self.bodies is not None:
            margins[self.bodies.resting(scene.pairs)] = 0.0
        return margins

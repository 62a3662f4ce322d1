"""Where a robot moves and what it touches there, as data: of a plan, or of a robot that stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.control.limits import torque_limits
from trajopt.dynamics.base_joint import BASE_JOINT, Base, base_of
from trajopt.motion.cycles import image_of_contacts
from trajopt.motion.description import PlanDescription
from trajopt.motion.samples import ContactPlaces, contact_places
from trajopt.motion.solution import Solution
from trajopt.motion.touched import TouchedSurfaces, held_contacts, touched_surfaces
from trajopt.robot.actuators.actuation import Actuation
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.natural_units import NaturalUnits
from trajopt.terrain.surface import Surface, by_plane, frame_of_normal

# Radius of the balls of links and of contacts that do not roll, and margin around the motion, in reaches.
BALL, AROUND = 1e-3, 2.0
# Links that a motion takes nearer to the ground than this, m, such as its feet, touch nothing.
CLEAR = 1e-3


@dataclass(frozen=True, kw_only=True)
class SceneRobot:
    """A robot with nu inputs as it is simulated.

    Args:
        model: its joints and inertias, without payloads.
        description: its contacts, limits, drives and shapes, and the ground and obstacles around it.
        actuated_rows: rows of v with a motor, in the order of the inputs.
        actuation: the map from inputs to generalised forces.
    """

    model: pin.Model
    description: PlanDescription
    actuated_rows: np.ndarray
    actuation: Actuation

    @property
    def base(self) -> Base:
        """Kind of the root joint."""
        return base_of(self.model)

    @property
    def nu(self) -> int:
        """Number of inputs: motors of joints, then thrusters."""
        return len(self.actuated_rows) + len(self.description.thrusters)

    @property
    def drives(self) -> tuple[Drive | None, ...]:
        """Drive of each input (nu,), None where there is none."""
        return self.description.drives or (None,) * self.nu

    @cached_property
    def units(self) -> NaturalUnits:
        """Natural units of the model."""
        return NaturalUnits.of(self.model)

    @cached_property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest inputs (nu,)."""
        return torque_limits(self.description, self.nu)


@dataclass(frozen=True, kw_only=True)
class Board:
    """A plane that contacts touch in some phases only.

    Args:
        surface: the plane.
        contacts: numbers of the contacts.
        points: positions (n, 3), m, at which they touch it; corners of soles.
    """

    surface: Surface
    contacts: tuple[int, ...]
    points: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Grasp:
    """A contact that is held over a run of phases.

    Args:
        name: name of its constraint.
        contact: number of the contact.
        turns: whether the constraint also fixes its rotation.
        phases: numbers of the phases.
        position: position (3,) of its frame, m, world.
        rotation: rotation (3, 3) of its frame.
    """

    name: str
    contact: int
    turns: bool
    phases: tuple[int, ...]
    position: np.ndarray
    rotation: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Site:
    """A robot, and the parts of its surroundings that a motion uses in each of its phases.

    Args:
        robot: the robot.
        low: lower corner (3,) of a box around the motion, m; infinite where it may go anywhere.
        high: upper corner (3,) of this box, m.
        standing: numbers of the contacts that touch the terrain.
        boards: planes of some phases.
        grasps: contacts that are held.
        buried: depth, m, of joints that the motion takes into the ground, by name; they touch nothing.
        sunk: names of links' shapes that the motion takes into the ground; they touch nothing.
        models: model of each phase, with its payloads.
        swings: whether each contact is in the air in each phase (phases, nc).
        surfaces: surfaces that contacts touch at the start of each phase.
        height: mean height of the base over the active contacts, m; zero without any.
    """

    robot: SceneRobot
    low: np.ndarray
    high: np.ndarray
    standing: tuple[int, ...]
    boards: tuple[Board, ...] = ()
    grasps: tuple[Grasp, ...] = ()
    buried: dict[str, float]
    sunk: frozenset[str]
    models: tuple[pin.Model, ...]
    swings: np.ndarray
    surfaces: TouchedSurfaces
    height: float

    @classmethod
    def of_plan(cls, plan: Solution) -> Site:
        """The site of a plan, from its samples."""
        robot = SceneRobot(
            model=plan.model,
            description=plan.description,
            actuated_rows=plan.actuated_rows,
            actuation=plan.actuation,
        )
        places, apart = contact_places(plan), plan.description.separate_surfaces
        starts = [rows.start for rows in plan.phases]
        return cls(
            standing=_standing(plan, apart),
            boards=_boards(plan, apart, places.position),
            grasps=_grasps(plan, places),
            models=tuple(plan.carrying_model(phase) for phase in range(len(plan.phases))),
            swings=~plan.active[starts],
            surfaces=touched_surfaces(plan.description, places.position[starts], plan.phase[starts]),
            **_around(robot, plan.q, places.position, plan.active, 0.0),
        )

    @classmethod
    def at_rest(cls, robot: SceneRobot, q: np.ndarray, standing: Sequence[int]) -> Site:
        """The site of a robot that begins at rest at q (nq,) on some contacts, and may go anywhere."""
        data, frames = robot.model.createData(), robot.description.frames
        pin.framesForwardKinematics(robot.model, data, q)
        feet = np.array([[data.oMf[robot.model.getFrameId(frame)].translation for frame in frames]])
        feet, active = feet.reshape(1, -1, 3), np.isin(np.arange(len(frames)), standing)[None]
        return cls(
            standing=tuple(standing),
            models=(robot.model,),
            swings=~active,
            surfaces=touched_surfaces(robot.description, feet, np.zeros(1, dtype=int)),
            **_around(robot, q[None], feet, active, np.inf),
        )

    @property
    def held(self) -> np.ndarray:
        """Whether each contact is held in each phase (phases, nc)."""
        held = np.zeros_like(self.swings)
        for grasp in self.grasps:
            held[list(grasp.phases), grasp.contact] = True
        return held


def _around(
    robot: SceneRobot, q: np.ndarray, feet: np.ndarray, active: np.ndarray, beyond: float
) -> dict[str, Any]:
    """Fields of a site for configurations (n, nq), with contacts (n, nc) at ``feet`` (n, nc, 3), m.

    The motion may leave them by ``beyond`` m along the ground.
    """
    model, data = robot.model, robot.model.createData()
    joints = np.zeros((len(q), model.njoints - 1, 3))
    for row, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        joints[row] = [data.oMi[i].translation for i in range(1, model.njoints)]
    points = np.concatenate([feet.reshape(-1, 3), joints.reshape(-1, 3)])
    around = AROUND * robot.units.length + np.array([beyond, beyond, 0.0])
    lowest = height_over(robot.description.ground, joints).min(axis=0)
    ball = BALL * robot.units.length
    return {
        "robot": robot,
        "low": points.min(axis=0) - around,
        "high": points.max(axis=0) + around,
        "buried": {
            name: -float(low)
            for name, low in zip(list(model.names)[1:], lowest, strict=True)
            if low < ball
        },
        "sunk": _sunk(robot, q),
        "height": mean_height(model, q, feet, active) if robot.base != "fixed" and active.any() else 0.0,
    }  # fmt: skip


def _sunk(robot: SceneRobot, q: np.ndarray) -> frozenset[str]:
    """Names of shapes that configurations (n, nq) take into the ground, as those around its feet."""
    scene = robot.description.body_scene(robot.model)
    if scene is None:
        return frozenset()
    near = scene.distances(q, CLEAR)[:, : scene.n_ground].min(axis=0) < CLEAR
    return frozenset(shape for (shape, _), deep in zip(scene.pairs, near, strict=False) if deep)


def height_over(terrain: Any, points: np.ndarray) -> np.ndarray:
    """Height (...) in m of points (..., 3) over the terrain; infinite over holes and without terrain."""
    if terrain is None:
        return np.full(points.shape[:-1], np.inf)
    if isinstance(terrain, Surface):
        return terrain.distance(points)
    return np.asarray(points[..., 2] - terrain.height(points[..., 0], points[..., 1]))


def _standing(plan: Solution, separate: Sequence[tuple[int, int, Surface]]) -> tuple[int, ...]:
    """Contacts that touch the terrain in some phase, or whose image in a periodic plan does."""
    elsewhere = {(phase, contact) for phase, contact, _ in separate}
    standing = {
        int(contact)
        for phase, rows in enumerate(plan.phases)
        for contact in np.flatnonzero(plan.active[rows.start])
        if (phase, contact) not in elsewhere
    }
    described = plan.description.periodicity
    if described:
        source = image_of_contacts(plan, described)
        standing |= {contact for contact, other in enumerate(source) if other in standing}
    return tuple(sorted(standing))


def _boards(
    plan: Solution, separate: Sequence[tuple[int, int, Surface]], feet: np.ndarray
) -> tuple[Board, ...]:
    """Unilateral planes with their contacts, which are at ``feet`` (K, nc, 3), m, at the samples."""
    touches = [touch for touch in separate if not touch[2].bilateral]
    return tuple(
        Board(
            surface=group[0][2],
            contacts=tuple(sorted({contact for _, contact, _ in group})),
            points=np.concatenate([_under(plan, group[0][2], feet, *touch[:2]) for touch in group]),
        )
        for group in by_plane(touches, lambda touch: touch[2])
    )


def _under(plan: Solution, surface: Surface, feet: np.ndarray, phase: int, contact: int) -> np.ndarray:
    """Positions (n, 3) of a contact in a phase; for a sole, a square on the plane around its corners."""
    places = feet[plan.phase == phase, contact]
    size = plan.description.contacts[contact].half_size
    if size is None:
        return places
    around = float(np.hypot(*size)) * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    turn = frame_of_normal(surface.normal)
    return np.concatenate([places + turn[:, :2] @ corner for corner in around])


def _grasps(plan: Solution, places: ContactPlaces) -> tuple[Grasp, ...]:
    """A grasp for each run of phases in which a contact is held on a bilateral surface."""
    grasps: list[Grasp] = []
    for contact, held in enumerate(held_contacts(plan.description, plan.phase).T):
        phases = [i for i, rows in enumerate(plan.phases) if held[rows.start]]
        runs = np.split(np.array(phases, dtype=int), np.flatnonzero(np.diff(phases) > 1) + 1)
        for run in (run for run in runs if len(run)):
            row = plan.phases[int(run[0])].start
            grasps.append(
                Grasp(
                    name=f"grasp{len(grasps)}",
                    contact=contact,
                    turns=plan.description.contacts[contact].is_sole,
                    phases=tuple(int(i) for i in run),
                    position=places.position[row, contact],
                    rotation=places.rotation[row, contact],
                )
            )
    return tuple(grasps)


def upwards(model: pin.Model) -> np.ndarray:
    """Direction (3,) against gravity; zero without gravity."""
    up = -np.array(model.gravity.linear)
    return np.asarray(up / (np.linalg.norm(up) or 1.0))


def base_poses(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Rotation and position (n, 3, 4) of the base link in the scene."""
    data, joint = model.createData(), BASE_JOINT[base_of(model)]
    bases = np.zeros((len(q), 3, 4))
    for row, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        bases[row, :, :3], bases[row, :, 3] = data.oMi[joint].rotation, data.oMi[joint].translation
    return bases


def mean_height(model: pin.Model, q: np.ndarray, feet: np.ndarray, active: np.ndarray) -> float:
    """Mean height, m, of the base at q (K, nq) over the active of the contacts at ``feet`` (K, nc, 3)."""
    over = (base_poses(model, q)[:, None, :, 3] - feet) @ upwards(model)
    return max(float(over[active].mean()), 0.0)

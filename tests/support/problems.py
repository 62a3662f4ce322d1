"""Small robots and problems: every mechanism of a real one, graphs that compile in a second."""

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.dynamics.manifold import Coordinates
from trajopt.problem.problem import Problem
from trajopt.robot.contact import Contact
from trajopt.robot.link_wrench import LinkWrench
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule import middle_of
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import (
    AccelerationCost,
    BaseDynamics,
    ContactAcceleration,
    Context,
    Cost,
    FrameHeight,
    FrictionCone,
    ImpulseCost,
    PointConstraint,
    PositionLimits,
    PostureCost,
    SoleLimits,
    Term,
    TerminalRest,
    TerminalState,
    TorqueCost,
    TorqueLimits,
    VelocityCost,
    VelocityLimits,
    WrenchCost,
)
from trajopt.terrain.flat import FlatGround
from trajopt.transcription.stage_functions import PointFunction, point_function

# Every scheme of the toolkit up to degree 3, with its order at the nodes.
SCHEME_ORDERS = {
    "legendre:1": 2,
    "legendre:2": 4,
    "legendre:3": 6,
    "radau:1": 1,
    "radau:2": 3,
    "radau:3": 5,
    "trapezoidal": 2,
    "hermite-simpson": 4,
    "semi-implicit-euler": 1,
}
FOOT = "foot"
REACH = 1.2  # rad, of the arm's motion
REACH_TIME = 0.8  # s


def _body(mass: float, size: float) -> pin.Inertia:
    return pin.Inertia.FromBox(mass, size, 1.5 * size, 2 * size)


def _limited(model: pin.Model) -> pin.Model:
    actuated = np.arange(model.nv) >= (model.joints[1].nv if model.joints[1].nv > 1 else 0)
    model.upperEffortLimit = np.where(actuated, 60.0, np.inf)
    model.lowerEffortLimit = -model.upperEffortLimit
    model.upperVelocityLimit = np.where(actuated, 20.0, np.inf)
    model.lowerVelocityLimit = -model.upperVelocityLimit
    model.armature = np.where(actuated, 0.02, 0.0)
    return model


def _leg(model: pin.Model, parent: int) -> pin.Model:
    """A hip turning about y, a sliding shank along z, and a foot frame at its end."""
    hip = model.addJoint(
        parent, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.02, 0.0, -0.1])), "hip",
        np.array([60.0]), np.array([20.0]), np.array([-1.5]), np.array([1.5]),
    )  # fmt: skip
    model.appendBodyToJoint(hip, _body(0.5, 0.1), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1])))
    shank = model.addJoint(
        hip, pin.JointModelPZ(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3])), "shank",
        np.array([60.0]), np.array([20.0]), np.array([-0.2]), np.array([0.2]),
    )  # fmt: skip
    model.appendBodyToJoint(shank, _body(0.2, 0.05), pin.SE3(np.eye(3), np.array([0.0, 0.01, -0.05])))
    model.addFrame(pin.Frame(FOOT, shank, 0, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1])), pin.OP_FRAME))
    return _limited(model)


@lru_cache
def hopper(kind: str = "point", mass: float = 3.0) -> Robot:
    """A floating body on one leg with a foot of that kind: eight velocities, six of them unactuated."""
    model = pin.Model()
    model.name = "hopper"
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, _body(mass, 0.2), pin.SE3(np.eye(3), np.array([0.01, 0.0, 0.02])))
    sole = {"half_length": 0.08, "half_width": 0.05} if kind == "surface" else {}
    contact = Contact(frame=FOOT, kind=kind, **sole)
    return Robot.from_model(_leg(model, base), contacts=[contact], name="hopper")


@lru_cache
def planar_hopper() -> Robot:
    """The same leg under a body that moves in a vertical plane."""
    model = pin.Model()
    model.name = "planar"
    turned = pin.SE3(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3))
    base = model.addJoint(0, pin.JointModelPlanar(), turned, "base")
    model.appendBodyToJoint(base, _body(3.0, 0.2), pin.SE3(turned.rotation.T, np.array([0.01, 0.02, 0.0])))
    hip = model.addJoint(base, pin.JointModelRZ(), pin.SE3(turned.rotation.T, np.zeros(3)), "turn")
    model.appendBodyToJoint(hip, _body(0.3, 0.1), pin.SE3.Identity())
    return Robot.from_model(_leg(model, hip), contacts=[Contact(frame=FOOT)], name="planar")


@lru_cache
def one_joint_arm(gravity: bool = False) -> Robot:
    """A bar turning about a horizontal axis, without limits."""
    model = pin.Model()
    model.name = "arm"
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(joint, _body(2.0, 0.2), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5])))
    if not gravity:
        model.gravity = pin.Motion.Zero()
    return Robot.from_model(model, reference=np.zeros(1), name="arm")


def one_phase(
    robot: Robot, *terms: Term, duration: float = 1.0, name: str = "move", **given: object
) -> Problem:
    """A problem of one phase without contacts, by default from rest in the reference."""
    schedule = Schedule((Phase(name=name, duration=duration),))
    return Problem(**{"name": name, "robot": robot, "schedule": schedule, "terms": terms, **given})


def reach(*, gravity: bool = False, terms: tuple[Term, ...] = (AccelerationCost(weight=1.0),)) -> Problem:
    """The arm from rest at 0 to rest at ``REACH`` in ``REACH_TIME``."""
    robot, goal = one_joint_arm(gravity), np.array([REACH])
    return Problem(
        name="reach",
        robot=robot,
        schedule=Schedule((Phase(name="reach", duration=REACH_TIME),)),
        initial_q=np.zeros(1),
        terms=(*terms, TerminalState(q=goal), TerminalRest(q=goal)),
        guess=lambda t: goal * np.clip(t / REACH_TIME, 0, 1),
        default_intervals=10,
    )


def hop(kind: str = "point", **changes: object) -> Problem:
    """The hopper leaves the ground, turns a little and lands: stance, flight, landing."""
    robot = hopper(kind)
    terms = [
        AccelerationCost(weight=1e-2), TorqueCost(weight=1.0), VelocityCost(weight=1e-2),
        WrenchCost(weight=1e-2),
        TorqueLimits(), PositionLimits(), VelocityLimits(), FrictionCone(friction=0.7),
        FrameHeight(frame=FOOT, height=0.02, at=middle_of("flight")),
    ]  # fmt: skip
    if kind == "surface":
        terms.append(SoleLimits(friction=0.7))
    return Problem(**{
        "name": "hop",
        "robot": robot,
        "schedule": Schedule((
            Phase(name="stance", duration=0.3, contacts=(FOOT,)),
            Phase(name="flight", duration=0.2),
            Phase(name="landing", duration=0.3, contacts=(FOOT,)),
        )),
        "terrain": FlatGround(),
        "initial_q": robot.reference,
        "initial_v": np.zeros(robot.nv),
        "terms": tuple(terms),
        "guess": lambda t: robot.reference,
        "default_intervals": 8,
        **changes,
    })  # fmt: skip


def lean() -> Problem:
    """The hopper on its foot for a moment, pushed over: one basin, where a hop has several."""
    terms = tuple(term for term in hop().terms if not isinstance(term, FrameHeight))
    stance = Schedule((Phase(name="stance", duration=0.1, contacts=(FOOT,)),))
    push = np.array([0.0, 0.0, 0.0, 0.3, -0.4, 0.5, 0.2, 0.1])
    return hop(schedule=stance, initial_v=push, terms=terms)


def phases(*, free: bool, impact: bool) -> Schedule:
    """Of the hop: with free durations of stance and flight, with an impact at touchdown."""
    bounds = {"stance": (0.15, 0.6), "flight": (0.1, 0.4)} if free else {}
    return Schedule(
        (
            Phase(name="stance", duration=0.3, contacts=(FOOT,), duration_bounds=bounds.get("stance")),
            Phase(name="flight", duration=0.2, duration_bounds=bounds.get("flight")),
            Phase(name="landing", duration=0.3, contacts=(FOOT,), impact=impact),
        )
    )


def landing(*, free: bool = False, impact: bool = False) -> Problem:
    """The hop with those phases, its impulse costed."""
    terms = (*hop().terms, *((ImpulseCost(weight=1e-2),) if impact else ()))
    return hop(schedule=phases(free=free, impact=impact), terms=terms)


def still() -> Problem:
    """The hopper balances on its foot and moves to another posture, as a source of velocity."""
    terms = (
        VelocityCost(weight=1.0),
        WrenchCost(weight=1e-2),
        PostureCost(weight=1.0),
        FrictionCone(friction=0.7),
        PositionLimits(),
        VelocityLimits(),
    )
    return replace(lean(), initial_v=np.zeros(8), actuation="velocity", terms=terms)


def point_of(
    robot: Robot,
    contacts: tuple[str, ...],
    terms: tuple[Term, ...],
    kind: type[Context] = Context,
    given: tuple[LinkWrench, ...] = (),
) -> tuple[PointFunction, np.ndarray]:
    """The point function of a phase, as a transcription builds it, and its parameters' values."""
    active = tuple(robot.contact(name) for name in contacts)
    surfaces = {name: FlatGround().surface for name in contacts}
    context = kind(robot, Coordinates(robot.model), active, node=False, surfaces=surfaces, given=given)
    units, always = Units(robot), (BaseDynamics(), ContactAcceleration())
    costs = [term.value(context, units) for term in terms if isinstance(term, Cost)]
    constraints = [term for term in (*always, *terms) if isinstance(term, PointConstraint)]
    found = [
        rows.expression for rows in (term.rows(context, units) for term in constraints) if rows is not None
    ]
    return point_function("point", context, sum(costs, ca.SX(0)), found), context.parameter_values


def random_point(robot: Robot, point: PointFunction, generator: np.random.Generator) -> np.ndarray:
    """Inputs z of a point function: unit rotations, all else within one unit of the reference."""
    coordinates = Coordinates(robot.model)
    z = generator.uniform(-1, 1, point.n_z)
    for i in range(coordinates.n_rotations):
        z[4 * i : 4 * i + 4] /= np.linalg.norm(z[4 * i : 4 * i + 4])
    return z


def inertia() -> float:
    """Of the arm about its joint, kg m^2."""
    model = one_joint_arm().model
    return float(model.inertias[1].matrix()[4, 4] + model.armature[0])


def limited_reach(torque: float) -> Problem:
    """The arm's reach with a torque limit, N m; 4 inertia REACH / REACH_TIME^2 is the least that suffices."""
    return reach(terms=(AccelerationCost(weight=1.0), TorqueLimits(limit=np.array([torque]))))

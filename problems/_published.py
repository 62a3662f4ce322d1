"""Problems with published optima: what they are, the value, its source, and how it is measured."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin

from trajopt.motion import Solution, integral
from trajopt.problem import Problem, PublishedOptimum
from trajopt.robot import Drive, Robot
from trajopt.schedule import Phase, Schedule
from trajopt.terms import (
    MotorTorqueCost,
    PositionLimits,
    Term,
    TerminalLinear,
    TerminalRest,
    TerminalState,
    TerminalVelocity,
    TimeCost,
    TorqueCost,
    TorqueLimits,
    VelocityCost,
    VelocityLimits,
)
from trajopt_library import robots

CLOSED, BRYSON = "closed form", "Bryson, Ho, Applied Optimal Control, 1975, sec. 3.11; closed form"
PSOPT = "Becerra, PSOPT user manual"
# Volts to torque behind the gears of the Manutec r3, gear ratios, rotor inertia in kg m^2: Otter, Tuerk,
# Mathematical model of the Manutec r3 robot (DFVLR model 2), 1988, as PSOPT's example has them.
MANUTEC_VOLT, MANUTEC_GEAR, MANUTEC_ROTOR = np.array([-126.0, 252.0, 72.0]), (-105.0, 210.0, 60.0), 1.3e-3


def _block(force: float = math.inf, most: float = math.inf) -> Robot:
    """Return 1 kg on a frictionless slide along x, a double integrator; limits in N and m."""
    model = pin.Model()
    model.name = "block"
    limits = (np.array([force]), np.array([math.inf]), np.array([-math.inf]), np.array([most]))
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide", *limits)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    return Robot.from_model(model)


def _chain(name: str, links: list[tuple[pin.JointModel, float, pin.Inertia]], gravity: float) -> Robot:
    """Return a chain of joints, each at a distance along z (x without gravity) from the previous one."""
    model = pin.Model()
    model.name = name
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    ahead, joint = np.array([0.0, 0.0, 1.0] if gravity else [1.0, 0.0, 0.0]), 0
    for number, (kind, distance, inertia) in enumerate(links, 1):
        joint = model.addJoint(joint, kind, pin.SE3(np.eye(3), distance * ahead), f"joint{number}")
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return Robot.from_model(model)


def _problem(
    name: str,
    robot: Robot,
    duration: float,
    terms: tuple[Term, ...],
    start: np.ndarray,
    end: np.ndarray,
    *,
    v: np.ndarray | None = None,
    free: tuple[float, float] | None = None,
) -> Problem:
    """Return a problem with a straight guess; ``free`` are the bounds of a free duration, s."""
    phase = (
        Phase(name="move", duration=duration)
        if free is None
        else (Phase(name="move", duration=duration, duration_bounds=free))
    )
    return Problem(
        name=name,
        robot=robot,
        schedule=Schedule((phase,)),
        initial_q=start,
        initial_v=np.zeros(robot.nv) if v is None else v,
        terms=terms,
        guess=lambda t: pin.interpolate(robot.model, start, end, min(max(t / duration, 0.0), 1.0)),
    )


def _effort(scale: float, unit: np.ndarray | float = 1.0):
    def value(solution: Solution) -> float:
        return scale * integral(solution, ((solution.tau / unit) ** 2).sum(axis=1))

    return value


def _duration(solution: Solution) -> float:
    return float(solution.t[-1] - solution.t[0])


def _double_integrator(end: tuple[Term, ...], v: float = 0.0, **limits: float) -> Problem:
    robot, still = _block(**limits), np.zeros(1)
    terms = (TorqueCost(weight=1.0), PositionLimits(), *end)
    return _problem("double-integrator", robot, 1.0, terms, still, still, v=np.array([v]))


def _rest_to_rest() -> Problem:
    there = np.array([1.0])
    return _double_integrator((TerminalState(q=there), TerminalRest(q=there)))


def _fly_by() -> Problem:
    return _double_integrator((TerminalState(q=np.array([1.0])),))


def _to_a_line() -> Problem:
    row = TerminalLinear(position=np.array([[1.0]]), velocity=np.array([[-2.0]]), value=np.array([1.0]))
    return _double_integrator((row,))


def _bryson_denham() -> Problem:
    back = np.zeros(1)
    ends = (TerminalState(q=back), TerminalVelocity(q=back, v=np.array([-1.0])))
    return _double_integrator(ends, v=1.0, most=0.1)


def _time_and_speed() -> Problem:
    robot, start, end = _block(force=1.0), np.array([2.0]), np.array([5.0])
    # Rates are over sqrt(g l): with a weight of g l (l is 1 m here) the cost is the integral of v^2.
    speed = VelocityCost(weight=9.81 * robot.length)
    terms = (TimeCost(weight=1.0), speed, TorqueLimits(), TerminalState(q=end), TerminalRest(q=end))
    return _problem("time-and-speed", robot, 5.0, terms, start, end, free=(1.0, 20.0))


def _time_and_speed_value(solution: Solution) -> float:
    return (_duration(solution) + integral(solution, solution.v[:, 0] ** 2)) / 2


def _block_time() -> Problem:
    robot, end = _block(force=1.0), np.array([0.25])
    terms = (TimeCost(weight=1.0), TorqueLimits(), TerminalState(q=end), TerminalRest(q=end))
    return _problem("block", robot, 1.5, terms, np.zeros(1), end, free=(0.2, 10.0))


def _two_link_arm() -> Problem:
    rod = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.diag([0.0, 1 / 12, 1 / 12]))
    tip = pin.Inertia(1.0, np.array([1.0, 0.0, 0.0]), np.zeros((3, 3)))
    turn = pin.JointModelRZ()
    robot = _chain("two-link-arm", [(turn, 0.0, rod), (turn, 1.0, rod + tip)], gravity=0.0)
    robot = replace(robot, torque_limit=np.ones(2))
    start, end = np.array([0.0, 0.5]), np.array([0.522, 0.5])
    terms = (TimeCost(weight=1.0), TorqueLimits(), TerminalState(q=end), TerminalRest(q=end))
    return _problem("two-link-arm", robot, 3.0, terms, start, end, free=(1.0, 10.0))


def _cart_pole() -> Problem:
    robot = robots.load("cart_pole")
    end = np.array([1.0, math.pi])
    terms = (TorqueCost(weight=1.0), TorqueLimits(), PositionLimits())
    ends = (TerminalState(q=end), TerminalRest(q=end))
    return _problem("cart-pole", robot, 2.0, (*terms, *ends), np.zeros(2), end)


def _manutec() -> Problem:
    """Return the three joints of DFVLR model 2 without load; rotors only turn with their gears."""

    def about_joint(mass: float, centre: list[float], moments: list[list[float]]) -> pin.Inertia:
        c = np.array(centre)
        return pin.Inertia(mass, c, np.array(moments) - mass * (c @ c * np.eye(3) - np.outer(c, c)))

    base = pin.Inertia(0.0, np.zeros(3), np.diag([0.0, 0.0, 1.16]))
    upper = about_joint(
        56.5,
        [0.172, 0.0, 0.205],
        [[4.9544125, 0.0, -2.45219], [0.0, 6.7759085, 0.0], [-2.45219, 0.0, 2.311496]],
    )
    fore = about_joint(
        60.3,
        [0.028, 0.0, 0.202],
        [[7.8704812, 0.0, -0.0110568], [0.0, 8.1077564, 0.0], [-0.0110568, 0.0, 0.4372752]],
    )
    about = pin.JointModelRX()
    robot = _chain(
        "manutec-r3", [(pin.JointModelRZ(), 0.0, base), (about, 0.0, upper), (about, 0.5, fore)], 9.81
    )
    limits = np.array([2.97, 2.01, 2.86])
    robot = replace(
        robot, position_lower=-limits, position_upper=limits, velocity_limit=np.array([3.0, 1.5, 5.2])
    )
    # 1.2 N m/V at every motor, limited to 7.5 V.
    robot = robot.with_drives(
        [Drive(gear_ratio=gear, rotor_inertia=MANUTEC_ROTOR, torque_limit=1.2 * 7.5) for gear in MANUTEC_GEAR]
    )
    start, end = np.array([0.0, -1.5, 0.0]), np.array([1.0, -1.95, 1.0])
    terms = (MotorTorqueCost(weight=1.0), TorqueLimits(), VelocityLimits(), PositionLimits())
    ends = (TerminalState(q=end), TerminalRest(q=end))
    return _problem("manutec-r3", robot, 0.53, (*terms, *ends), start, end)


def _betts_pendulum() -> Problem:
    """Return the swing of a unit mass at unit distance, from level at rest to hanging at rest."""
    mass = pin.Inertia(1.0, np.array([1.0, 0.0, 0.0]), np.zeros((3, 3)))
    robot = _chain("pendulum", [(pin.JointModelRY(), 0.0, mass)], 9.81)
    end = np.array([math.pi / 2])
    terms = (TorqueCost(weight=1.0), TerminalState(q=end), TerminalRest(q=end))
    return _problem("pendulum", robot, 3.0, terms, np.zeros(1), end)


def optima() -> tuple[PublishedOptimum, ...]:
    """All of them."""
    energy, half = "integral of u^2", "half the integral of u^2"
    return (
        PublishedOptimum("rest to rest", _rest_to_rest, _effort(1.0), energy, 12.0, 1e-6, CLOSED),
        PublishedOptimum("final speed free", _fly_by, _effort(0.5), half, 1.5, 1e-6, CLOSED),
        PublishedOptimum("to x1 - 2 x2 = 1", _to_a_line, _effort(0.5), half, 3 / 14, 1e-6, CLOSED),
        PublishedOptimum(
            "time and speed",
            _time_and_speed,
            _time_and_speed_value,
            "half the integral of 1 + v^2",
            10 / 3,
            1e-4,
            CLOSED,
        ),
        PublishedOptimum("Bryson and Denham", _bryson_denham, _effort(0.5), half, 40 / 9, 1e-4, BRYSON),
        PublishedOptimum("block of 1 kg, 1 N", _block_time, _duration, "least time, s", 1.0, 1e-6, CLOSED),
        PublishedOptimum(
            "two-link arm",
            _two_link_arm,
            _duration,
            "least time, s",
            2.9823,
            1e-3,
            f"Luus, Iterative Dynamic Programming, 2000; {PSOPT}: 2.9887",
        ),
        PublishedOptimum(
            "cart-pole",
            _cart_pole,
            _effort(1.0),
            energy,
            58.83,
            1e-3,
            "Kelly, SIAM Review 59(4), 2017, and Dymos: 58.83 to 58.89 on coarse meshes",
        ),
        PublishedOptimum(
            "Manutec r3",
            _manutec,
            _effort(1.0, MANUTEC_VOLT),
            "integral of u'u, V^2 s",
            20.406,
            5e-3,
            PSOPT,
        ),
        PublishedOptimum(
            "pendulum",
            _betts_pendulum,
            _effort(1.0),
            energy,
            12.873885,
            1e-4,
            "Betts, A Collection of Optimal Control Test Problems, 2015, 10.103; opty",
        ),
    )

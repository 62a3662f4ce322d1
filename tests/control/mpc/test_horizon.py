"""A horizon: numbers in place equal building anew, a shifted optimum stays one, limits are hard."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from trajopt.control.mpc.clock import GaitClock
from trajopt.control.mpc.commands import Command
from trajopt.control.mpc.gait_reference import GaitReference, RestingFeet, half_stance
from trajopt.control.mpc.ground import GroundEstimate
from trajopt.control.mpc.horizon import COMPLIANCE, Horizon, Pattern
from trajopt.control.mpc.motion import HorizonMotion
from trajopt.control.mpc.payload import PAYLOAD, LoadedBaseDynamics, carrying, payload_numbers
from trajopt.control.mpc.planner import HorizonPlanner, PlannerSettings
from trajopt.control.mpc.plans import SolverSettings
from trajopt.control.mpc.reference import HorizonWeights, leg_terms
from trajopt.control.mpc.shifting import IterateMap
from trajopt.robot import Robot
from trajopt.schedule.gaits import gait_of
from trajopt_library import robots

pytestmark = pytest.mark.long
PERIOD = 0.5
WEIGHTS = HorizonWeights()


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robots.load("go2")


def pairs(robot: Robot, gait: str = "trot") -> tuple[tuple[str, ...], tuple[str, ...]]:
    first, second = (phase.contacts for phase in gait_of(robot, gait).phases(PERIOD)[:2])
    return first, second


def horizon_of(robot: Robot, *contacts: tuple[str, ...], count: int = 3, **settings: Any) -> Horizon:
    terms = leg_terms(robot, WEIGHTS, contacts)
    return Horizon(robot, Pattern(contacts, (count,) * len(contacts)), terms, **settings)


def at(horizon: Horizon, durations: list[float]) -> None:
    horizon.set_durations(np.array(durations))


def values(horizon: Horizon, x: np.ndarray) -> list[np.ndarray]:
    engine = horizon.nlp.engine
    multipliers = np.cos(np.arange(len(horizon.compliance)))
    return [
        np.array([engine.f(x)]),
        engine.g(x),
        engine.gradient(x),
        engine.jacobian(x),
        engine.hessian(x, 1.0, multipliers),
    ]


def test_durations_in_place_equal_building_anew(robot: Robot) -> None:
    """Bit by bit for the same nominal durations, whatever was set before; to rounding for others."""
    contacts, durations = pairs(robot), [0.137, 0.25]
    used, fresh = horizon_of(robot, *contacts), horizon_of(robot, *contacts)
    other = horizon_of(robot, *contacts, nominal=0.2)
    generator = np.random.default_rng(0)
    x = used.guess() + 0.1 * generator.standard_normal(used.layout.n_unknowns)
    at(used, [0.01, 0.4])
    used.nlp.engine.hessian(x, 1.0, np.ones(len(used.compliance)))
    for horizon in (used, fresh, other):
        at(horizon, durations)
    for own, anew, apart in zip(*(values(each, x) for each in (used, fresh, other)), strict=True):
        assert_array_equal(own, anew)
        assert_allclose(own, apart, rtol=1e-9, atol=1e-9 * max(1.0, float(np.abs(own).max())))
    assert_allclose(used.node_times[[0, 3, 6]], [0.0, 0.137, 0.387])


@pytest.mark.parametrize("name", ["go2", "g1"])
def test_friction_and_what_the_base_carries_in_place_equal_building_anew(name: str) -> None:
    """Rows of a robot whose model has the mass, with the same unscaled variables; a mass of zero is none."""
    robot = robots.load(name)
    contacts = pairs(robot, "trot" if name == "go2" else "walk")
    payload = payload_numbers(0.2 * robot.weight / 9.81, [0.05, 0.02, -0.1])
    loaded = replace(robot, model=carrying(robot.model, payload))
    used, fresh = (horizon_of(robot, *contacts, balance=given) for given in (LoadedBaseDynamics(), None))
    heavy = horizon_of(loaded, *contacts, friction=0.4)
    x = used.guess() + 0.1 * np.random.default_rng(0).standard_normal(used.layout.n_unknowns)
    points = len(used.point_times(PAYLOAD))
    used.set_numbers(PAYLOAD, np.tile(payload, (points, 1)))
    used.set_friction(0.4)
    at(used, [0.137, 0.25])
    at(heavy, [0.137, 0.25])
    own = used.nlp.engine.g(x)
    anew = heavy.nlp.engine.g(x * used.transcription.scale / heavy.transcription.scale)
    of_force = np.isin(
        np.array(used.transcription.rows.names)[used.transcription.rows.block],
        ["loaded_base_dynamics", "friction_pyramid", "sole_cone", "torque_limits"],
    )
    anew[of_force] *= loaded.weight / robot.weight
    assert_allclose(own, anew, rtol=1e-9, atol=1e-12)
    used.set_numbers(PAYLOAD, np.zeros((points, 4)))
    used.set_friction(0.7)
    for horizon in (used, fresh):
        at(horizon, [0.137, 0.25])
    for own, anew in zip(values(used, x), values(fresh, x), strict=True):
        assert_allclose(own, anew, rtol=1e-12, atol=1e-14)


def ahead_of(robot: Robot, clock: GaitClock, command: Command) -> GaitReference:
    """What a plan from the reference posture on level ground follows."""
    return GaitReference(
        feet=RestingFeet(robot, clock.contacts),
        base=robot.reference,
        command=command,
        heading=0.0,
        ground=GroundEstimate(4, robot.length),
        swings=clock.swings(),
        half_stance=half_stance(clock),
        lifts=(0.25 * robot.length, 0.1 * robot.length),
    )


def solved(horizon: Horizon, planner: HorizonPlanner, start: np.ndarray, barrier: float = 1e-4):
    """The optimum of a horizon at a barrier, usually the least of its planner."""
    solver = SolverSettings(tolerance=1e-9, most_steps=80, steps=80, barrier=barrier)
    iterate = solver.fresh(horizon, planner._gliding(horizon, start, 0))
    return solver.solve(horizon, iterate, 80)


def test_a_shifted_optimum_changes_by_no_more_than_the_solver_leaves(robot: Robot) -> None:
    """Bellman: what is left of an optimal motion after its first phase is optimal from there."""
    first, second = pairs(robot)
    clock = GaitClock(tuple(gait_of(robot, "trot").feet), {"trot": (gait_of(robot, "trot"), PERIOD)})
    planner = HorizonPlanner(robot, clock, PlannerSettings())
    whole, rest = horizon_of(robot, first, second, first), horizon_of(robot, second, first)
    start = whole.layout.coordinates.node_from_pinocchio(robot.reference, np.zeros(robot.nv))
    command = Command(gait="trot", speed=0.3)
    for horizon, durations in ((whole, [0.2, 0.25, 0.25]), (rest, [0.25, 0.25])):
        at(horizon, durations)
        heights = [dict.fromkeys(clock.contacts, 0.022) for _ in horizon.landings]
        horizon.set_heights(heights)
    clock.request("trot")
    ahead = ahead_of(robot, clock, command)
    times = whole.point_times("reference")
    whole.set_numbers("reference", ahead.rows(times))
    at(whole, [0.2, 0.25, 0.25])
    whole.set_start(start)
    iterate, reports = solved(whole, planner, start)
    assert max(reports[-1][key] for key in ("primal", "dual", "complementarity")) < 1e-9
    rest.set_numbers("reference", ahead.rows(rest.point_times("reference") + 0.2))
    at(rest, [0.25, 0.25])
    node = (iterate["x"] * whole.transcription.scale)[whole.layout.node(3)]
    rest.set_start(node)
    moved = IterateMap.of(whole, rest).apply(whole, rest, iterate, SolverSettings(), planner._gliding)
    after, reports = SolverSettings(steps=1).solve(rest, moved, 1)
    assert reports[0]["primal"] < 1e-8
    assert reports[0]["dual"] < 1e-7
    assert_allclose(after["x"], moved["x"], atol=1e-7)


def test_the_rate_of_the_cost_with_a_duration_is_that_of_optima(robot: Robot) -> None:
    """Against optima for other durations: what the first phase gains, the last loses."""
    first, second = pairs(robot)
    clock = GaitClock(tuple(gait_of(robot, "trot").feet), {"trot": (gait_of(robot, "trot"), PERIOD)})
    planner = HorizonPlanner(robot, clock, PlannerSettings())
    clock.request("trot")
    clock.skip()
    horizon = horizon_of(robot, first, second)
    horizon.compliance[:] = 0.0
    horizon.set_heights([dict.fromkeys(clock.contacts, 0.022) for _ in horizon.landings])
    start = horizon.layout.coordinates.node_from_pinocchio(robot.reference, np.zeros(robot.nv))
    horizon.set_start(start)
    at(horizon, [0.2, 0.25])
    rows = ahead_of(robot, clock, Command(gait="trot", speed=0.5)).rows(horizon.point_times("reference"))
    costs, moved = [], 2e-3
    for change in (0.0, moved, -moved):
        horizon.set_numbers("reference", rows)
        at(horizon, [0.2 + change, 0.25 - change])
        iterate, reports = solved(horizon, planner, start, barrier=1e-7)
        assert max(reports[-1][key] for key in ("primal", "dual")) < 1e-8
        costs.append(horizon.nlp.engine.f(iterate["x"]))
        if not change:
            rate = horizon.duration_gradient(iterate["x"], iterate["y"])
            assert_array_equal(horizon.durations, [0.2, 0.25])
    assert rate == pytest.approx((costs[1] - costs[2]) / (2 * moved), rel=1e-2)
    assert abs(rate) > 1e-3


def test_plans_keep_their_limits_and_say_what_they_relax(robot: Robot) -> None:
    """From a start so high that the feet that land cannot reach the ground: their landing gives way."""
    clock = GaitClock(tuple(gait_of(robot, "trot").feet), {"trot": (gait_of(robot, "trot"), PERIOD)})
    planner = HorizonPlanner(robot, clock, PlannerSettings())
    clock.request("trot")
    clock.skip()
    ahead = ahead_of(robot, clock, Command(gait="trot"))
    motion = planner.plan(0.0, robot.reference, np.zeros(robot.nv), ahead)
    assert isinstance(motion, HorizonMotion)
    limit = robot.torque_limit
    assert limit is not None
    for time in np.linspace(0.0, motion.duration, 40):
        sample = motion.sample(float(time))
        assert (np.abs(sample.torque) <= 1.02 * limit).all()
        assert sample.forces[~sample.active] == pytest.approx(0.0)
    assert max(planner.report.violations.values()) < planner.settings.solver.tolerance
    assert not any(planner.report.relaxed.values())
    high = robot.reference.copy()
    high[2] += 2 * robot.length
    for k in range(4):
        planner.plan(0.01 * k, high, np.zeros(robot.nv), ahead)
    assert any(planner.report.relaxed.values())
    assert set(COMPLIANCE) & set(planner.report.violations)


def test_a_horizon_samples_its_own_nodes(robot: Robot) -> None:
    horizon = horizon_of(robot, *pairs(robot), count=2)
    at(horizon, [0.1, 0.2])
    horizon.set_start(horizon.layout.coordinates.node_from_pinocchio(robot.reference, np.zeros(robot.nv)))
    motion = HorizonMotion(horizon, horizon.guess(), 1.0)
    first = motion.sample(0.0)
    assert_allclose(first.q, robot.reference, atol=1e-12)
    assert motion.duration == pytest.approx(0.3)
    assert first.active.tolist() == [contact.name in pairs(robot)[0] for contact in robot.contacts]
    assert motion.sample(9.0).q.shape == (robot.nq,)

"""Periodic motions: the closing rows, free starts, and a real robot's trot as a whole and as a half cycle."""

import math
from dataclasses import asdict, replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.refusals import refusals
from trajopt import FlatGround, InputError, Phase, Problem, Schedule, terms
from trajopt.certify.report import RESIDUAL
from trajopt.dynamics import Coordinates
from trajopt.motion.configurations import SolutionMotion
from trajopt.motion.cycles import periodic_image
from trajopt.motion.description import PeriodicImage
from trajopt.problem import Periodicity
from trajopt.problem.periodicity import closing_map, landing_at_start
from trajopt.robot import contact_positions, inverse_kinematics
from trajopt.robot.mirror import find_mirror, mirrored_configuration
from trajopt_library.robots import hopper, solo12

SPEED, PERIOD = 0.4, 0.4  # m/s, s
# Two solves to 1e-6 of the same optimum, the whole cycle and twice its half, agree far closer than this.
SAME_OPTIMUM = 1e-6
ROUNDING = 1e-12
PAIRS = (("FL_FOOT", "HR_FOOT"), ("FR_FOOT", "HL_FOOT"))


@lru_cache(maxsize=1)
def _solo():
    return solo12.build()


def _trot_guess(t: float) -> np.ndarray:
    """Base at constant speed; diagonal feet on the ground half of the period each, swung over the rest."""
    robot, advance = _solo(), SPEED * PERIOD
    q = robot.reference.copy()
    q[0] += SPEED * t
    feet = {}
    for name, place in contact_positions(robot, robot.reference).items():
        cycles = t / PERIOD + (0.0 if name in PAIRS[0] else 0.5)
        whole, part = math.floor(cycles), cycles - math.floor(cycles)
        shift = advance * (whole + 0.25 - (0.0 if name in PAIRS[0] else 0.5))
        foot = place + np.array([shift, 0.0, 0.0])
        if part > 0.5:
            s = 2 * part - 1
            foot += [advance * s, 0.0, 0.8 * s * s * (1 - s) ** 2]
        feet[name] = foot
    return inverse_kinematics(robot, q, feet).q


def trot(*, half: bool = False, free: bool = False, **periodicity: object) -> Problem:
    """A trot of Solo12 at a constant mean speed, without anything that names a place."""
    robot, ground = _solo(), FlatGround()
    bounds = (0.5 * PERIOD / 2, 1.5 * PERIOD / 2) if free else None
    phases = [
        Phase(name=name, duration=PERIOD / 2, contacts=pair, duration_bounds=bounds)
        for name, pair in zip(("first", "second"), PAIRS, strict=True)
    ]
    given = {"velocity": (SPEED, 0.0, 0.0), "mirror": half} | periodicity
    total = PERIOD / 2 if half else PERIOD
    return Problem(
        name="trot",
        robot=robot,
        schedule=Schedule(tuple(phases[: 1 if half else 2])),
        terrain=ground,
        terms=(
            terms.TorqueCost(weight=1.0),
            terms.AccelerationCost(weight=2e-2),
            terms.VelocityCost(weight=1e-2),
            terms.WrenchCost(weight=1e-2),
            terms.TorqueLimits(limit=np.full(robot.nu, 3.0)),
            terms.FrictionPyramid(),
            terms.PositionLimits(),
            terms.SwingClearance(height=0.03, terrain=ground),
        ),
        guess=_trot_guess,
        periodicity=Periodicity(**given),
        duration_bounds=(total, total) if free else None,
        default_intervals=6 if half else 12,
    )


@lru_cache(maxsize=4)
def _solved(half: bool, free: bool = False) -> trajopt.Solution:
    return trajopt.solve(trot(half=half, free=free), fixed_mesh=True)


def test_trot_is_an_orbit_that_closes() -> None:
    solution = _solved(False)
    report = trajopt.check(solution)
    assert solution.converged
    assert report.periodicity_error is not None
    assert report.periodicity_error < RESIDUAL
    assert solution.q[-1][0] - solution.q[0][0] == pytest.approx(SPEED * PERIOD, abs=ROUNDING)
    np.testing.assert_allclose(solution.q[-1][1:], solution.q[0][1:], atol=1e-8)
    np.testing.assert_allclose(solution.v[-1], solution.v[0], atol=1e-7)


def test_feet_that_land_with_the_start_stand_on_the_ground_at_rest() -> None:
    solution = _solved(False)
    robot, names = _solo(), PAIRS[0]
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, solution.q[0], solution.v[0])
    pin.updateFramePlacements(robot.model, data)
    for name in names:
        frame = robot.model.getFrameId(name)
        assert data.oMf[frame].translation[2] == pytest.approx(robot.contact(name).radius, abs=1e-8)
        velocity = pin.getFrameVelocity(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
        assert np.abs(velocity).max() < 1e-6


def test_half_a_cycle_and_its_mirror_image_are_the_whole_cycle() -> None:
    half = _solved(True)
    assert half.converged
    motion, mirror = SolutionMotion(half), find_mirror(_solo())

    def twice(t: float) -> np.ndarray:
        at = np.array([0]), np.array([2 * t / PERIOD % 1])
        q = motion.in_phase(*at, 0.5).q[0] if t < PERIOD else half.q[-1]
        if t < PERIOD / 2:
            return q
        q = mirrored_configuration(_solo(), mirror, q, 0.0)
        q[0] += SPEED * PERIOD / 2
        return q

    # cheaper ones are not symmetric: this is the one near the half's
    whole = trajopt.solve(replace(trot(), guess=twice), fixed_mesh=True)
    assert 2 * half.statistics.objective == pytest.approx(whole.statistics.objective, rel=1e-4)
    robot = _solo()
    mirrored = mirrored_configuration(robot, find_mirror(robot), half.q[0], 0.0)
    mirrored[0] += SPEED * PERIOD / 2
    np.testing.assert_allclose(half.q[-1], mirrored, atol=1e-8)


@pytest.mark.long
def test_free_durations_keep_the_period_and_the_speed() -> None:
    solution = _solved(False, True)
    assert solution.converged
    assert solution.t[-1] == pytest.approx(PERIOD, rel=1e-9)
    assert sum(solution.meta["durations"]) == pytest.approx(PERIOD, rel=1e-9)
    report = trajopt.check(solution)
    assert report.periodicity_error is not None
    assert report.periodicity_error < RESIDUAL
    assert solution.statistics.objective <= _solved(False).statistics.objective * (1 + SAME_OPTIMUM)


@pytest.mark.parametrize("perturb", [0.1])
def test_a_perturbed_start_finds_the_same_orbit(perturb: float) -> None:
    again = trajopt.solve(trot(half=True), perturb=perturb, seed=3, fixed_mesh=True)
    assert again.converged
    assert again.statistics.objective == pytest.approx(_solved(True).statistics.objective, rel=SAME_OPTIMUM)


def test_a_file_keeps_what_closes_the_motion(tmp_path) -> None:
    solution = _solved(True)
    report = trajopt.check(solution.save(tmp_path / "half.npz"))
    assert report.periodicity_error == pytest.approx(trajopt.check(solution).periodicity_error)
    moved = replace(solution, q=solution.q + np.linspace(0, 1, solution.n_samples)[:, None] * np.eye(19)[2])
    found = trajopt.check(moved).periodicity_error
    assert found == pytest.approx(
        1.0, rel=1e-2
    )  # a metre, seen in the axes of a base that is tilted a little


@pytest.mark.parametrize(
    ("given", "where"),
    [
        ({"velocity": (0.3, 0.1, 0.0)}, None),
        ({"translation": (0.2, 0.0, 0.1), "turn": 0.4}, None),
        ({"velocity": (0.3, 0.0, 0.0), "mirror": True}, None),
        ({"translation": (0.0, 0.2, 0.0), "turn": -1.0}, "turned"),
    ],
)
def test_closing_rows_vanish_exactly_at_the_image(given: dict[str, object], where: str | None) -> None:
    robot, made = _solo(), Periodicity(**given)
    generator = np.random.default_rng(5)
    origin = robot.reference.copy()
    if where == "turned":
        origin[:7] = pin.SE3ToXYZQUAT(pin.SE3(pin.utils.rotate("z", 2.5), np.array([3.0, -1.0, 0.3])))
    q = pin.integrate(robot.model, origin, generator.uniform(-0.3, 0.3, robot.nv))
    v = generator.normal(size=robot.nv)
    index, sign = made.images(robot)
    described = PeriodicImage(index=index, sign=sign, origin=origin[:3], **asdict(made))
    q_end, v_end = periodic_image(robot.model, described, q, v, 0.7)
    coordinates, closing = Coordinates(robot.model), closing_map(robot, made, origin)
    first, last = (coordinates.node_from_pinocchio(*state) for state in ((q, v), (q_end, v_end)))
    if first[:4] @ last[:4] < 0 and not made.mirror and not made.turn:
        last[:4] = -last[:4]
    bound = closing.constant + closing.translated @ made.moved(0.7)
    np.testing.assert_allclose(closing.left @ last - closing.right @ first, bound, atol=ROUNDING)
    assert np.linalg.matrix_rank(np.hstack([closing.left, -closing.right])) == len(closing.left)


def test_planar_robot_moves_in_its_plane() -> None:
    robot = hopper.build()
    made = Periodicity(translation=(0.3, 0.0, 0.1))
    closing = closing_map(robot, made, robot.reference)
    coordinates = Coordinates(robot.model)
    first = coordinates.node_from_pinocchio(robot.reference, np.zeros(robot.nv))
    last = first.copy()
    last[:2] += [0.3, 0.1]
    bound = closing.constant + closing.translated @ made.moved(1.0)
    np.testing.assert_allclose(closing.left @ last - closing.right @ first, bound, atol=ROUNDING)


def test_contacts_that_hold_across_the_end_do_not_land_at_the_start() -> None:
    robot = _solo()
    phases = (
        Phase(name="all", duration=0.1, contacts=(*PAIRS[0], *PAIRS[1])),
        Phase(name="first", duration=0.1, contacts=PAIRS[0]),
        Phase(name="none", duration=0.1),
        Phase(name="second", duration=0.1, contacts=PAIRS[1]),
    )
    assert landing_at_start(robot, Schedule(phases), Periodicity()) == PAIRS[0]
    half = Schedule(phases[:2])
    assert landing_at_start(robot, half, Periodicity(mirror=True)) == PAIRS[0]


test_impossible_periodicities_are_refused = refusals(
    lambda given: Periodicity(**given),
    ({"translation": (0, 0, 0), "velocity": (0, 0, 0)}, "one of them"),
    ({"velocity": (0.1, 0.0)}, "3 finite numbers"),
    ({"velocity": (0.1, 0.0, math.nan)}, "3 finite numbers"),
    ({"turn": math.inf}, "finite number"),
    ({"turn": 0.1, "mirror": True}, "turn=0"),
)


def test_problems_that_cannot_close_are_refused() -> None:
    problem = trot()
    standing = Schedule((Phase(name="stand", duration=1.0, contacts=(*PAIRS[0], *PAIRS[1])),))
    with pytest.raises(InputError, match="all the time"):
        replace(problem, schedule=standing)
    planar = hopper.build()
    with pytest.raises(InputError, match="free-flyer"):
        closing_map(planar, Periodicity(mirror=True), planar.reference)
    with pytest.raises(InputError, match="duration_bounds"):
        replace(problem, duration_bounds=(1.0, 2.0))
    with pytest.raises(InputError, match="duration_bounds"):
        replace(problem, duration_bounds=("a", 2.0))
    with pytest.raises(InputError, match="velocity source"):
        replace(problem, actuation="velocity", terms=())

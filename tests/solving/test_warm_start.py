"""Solutions as starts: resampled onto grids, schemes, durations; what they give a solver; what is refused."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.problems import FOOT, REACH, REACH_TIME, SCHEME_ORDERS, hop, planar_hopper, reach
from tests.support.solved_problems import ROUNDING, SAME_STATE, Solved, solved, solved_hop
from trajopt import InputError, Phase, Problem, Schedule, Solution, motion_of
from trajopt.errors import SolutionFileError
from trajopt.solving.extraction import extract
from trajopt.solving.solving import prepare
from trajopt.solving.warm_start import warm_start
from trajopt.terms import AccelerationCost, FrameHeight, TorqueCost, VelocityCost
from trajopt.transcription.violations import row_violations
from trajopt_library import problems

# What the solver's tolerance leaves in rows that repeat a state (changes of coordinates).
DEFECT = 1e-6
SOLVED = 1e-6
# A solution normalises quaternions, but its rates were turned by them as they were.
PER_NORM = 20.0
# IPOPT relaxes bounds by 1e-9; a free duration starts within its own.
RELAXED = 2e-9


def impact_hop() -> Problem:
    phases = hop().schedule.phases
    return hop(schedule=Schedule((*phases[:2], replace(phases[2], impact=True))))


def timed_hop(nominal: float = 1.0) -> Problem:
    """The hop with a free flight, whose nominal duration is a multiple of the hop's."""
    phases = hop().schedule.phases
    flight = replace(phases[1], duration=0.2 * nominal, duration_bounds=(0.1, 0.4))
    return hop(schedule=Schedule((phases[0], flight, phases[2])))


def swing() -> Problem:
    return reach(gravity=True, terms=(TorqueCost(weight=1.0), VelocityCost(weight=0.1)))


# The same grid


@pytest.mark.long
@pytest.mark.parametrize("name", [*SCHEME_ORDERS, "legendre:4", "radau:4"])
def test_the_same_grid_gives_back_the_solvers_unknowns(name):
    # On six intervals a scheme of order one turns the hopper by most of half a turn in one of them.
    intervals = 12 if SCHEME_ORDERS.get(name) == 1 else 6
    assert_start_is_exact(solved(hop(), name, intervals))


@pytest.mark.long
@pytest.mark.parametrize(
    "problem",
    [
        impact_hop(),
        timed_hop(),
        timed_hop(1.3),
        hop("surface"),
        hop(
            robot=planar_hopper(),
            initial_q=planar_hopper().reference,
            initial_v=np.zeros(planar_hopper().nv),
            guess=lambda t: planar_hopper().reference,
        ),
    ],
    ids=["impact", "free duration", "other nominal duration", "surface contact", "planar base"],
)  # fmt: skip
def test_the_same_grid_gives_back_the_solvers_unknowns_of_every_kind(problem):
    assert_start_is_exact(solved(problem, "legendre:2", 6))


def assert_start_is_exact(case: Solved) -> None:
    start = warm_start(case.transcription, case.solution)
    norm = case.solution.statistics.rotation_norm_error
    t, x = case.transcription, case.result.x
    apart = np.abs(start.x - x) / np.maximum(1.0, np.abs(x))
    inside = (t.lower_x <= x) & (x <= t.upper_x)
    durations = inside[t.layout.node(0)][t.layout.forms[0].time_scales]  # others are copies
    relaxed = 0.0 if durations.all() else RELAXED
    assert apart[inside].max() <= ROUNDING + PER_NORM * norm + relaxed
    assert apart[~inside].max(initial=0.0) <= RELAXED
    assert start.multipliers is not None
    assert_allclose(start.multipliers.lam_g, case.result.lam_g, rtol=ROUNDING, atol=ROUNDING)
    assert_allclose(start.multipliers.lam_x, case.result.lam_x, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize("coordinates", ["excess", "minimal"])
def test_the_same_grid_gives_back_phases_in_minimal_coordinates(coordinates):
    problem = problems.load("hopper-hop", coordinates=coordinates, touchdown="impact")
    case = solved(problem, "legendre:2", 12)
    start = warm_start(case.transcription, case.solution)
    assert_allclose(start.x, case.result.x, atol=DEFECT)


def test_quaternions_of_either_sign_give_one_start():
    case = solved_hop()
    flipped = case.solution.q.copy()
    flipped[::2, 3:7] *= -1
    start = warm_start(case.transcription, replace(case.solution, q=flipped))
    assert_array_equal(start.x, warm_start(case.transcription, case.solution).x)
    nodes = [start.x[case.transcription.layout.node(k)][:4] for k in range(9)]
    assert all(before @ after > 0.5 for before, after in pairwise(nodes))


# Other grids, durations, parameters


@pytest.mark.parametrize("name", ["legendre:2", "legendre:3", "radau:2"])
def test_rows_on_a_finer_grid_are_violated_by_the_collocation_error(name):
    violations = []
    for intervals in (8, 16):
        solution = solved(swing(), name, intervals).solution
        fine = prepare(swing(), transcription=name, intervals=2 * intervals)
        start = warm_start(fine.transcription, solution)
        gaps = np.concatenate(fine.transcription.gap_rows)
        violations.append(float(row_violations(fine.nlp, start.x)[gaps].max()))
    # Nodes are polynomials' own values: a defect is that of halving them, at rounding where they nest.
    assert max(violations) < SAME_STATE


def test_states_between_schemes_agree_to_the_collocation_error():
    errors = []
    for intervals in (6, 12):
        start = warm_start(
            prepare(swing(), transcription="radau:3", intervals=7).transcription,
            solved(swing(), "legendre:2", intervals).solution,
        )
        reference = solved(swing(), "legendre:3", 30)
        fine = prepare(swing(), transcription="radau:3", intervals=7).transcription
        exact = warm_start(fine, reference.solution)
        nodes = np.concatenate([np.arange(2) + fine.layout.node(k).start for k in range(8)])
        errors.append(np.abs(start.x - exact.x)[nodes].max())
    # Between nodes positions of legendre:2 are of order 3 or better, rates of order 2.
    assert errors[1] < errors[0] / 3
    assert errors[0] < 0.1


def test_another_duration_scales_rates_and_accelerations():
    slower = replace(reach(), schedule=Schedule((Phase(name="reach", duration=2 * REACH_TIME),)))
    coarse = trajopt.solve(reach(), fixed_mesh=True)
    t = prepare(slower, transcription="legendre:3", intervals=9).transcription
    motion = extract(t, warm_start(t, coarse).x)
    s = motion.t / (2 * REACH_TIME)
    # The known optimum, a cubic (see test_solving), is the same in every duration; linear acceleration
    # within legendre:2's intervals is exact.
    assert_allclose(motion.q[:, 0], REACH * s**2 * (3 - 2 * s), atol=SOLVED)
    assert_allclose(motion.v[:, 0], REACH * 6 * s * (1 - s) / (2 * REACH_TIME), atol=SOLVED)
    assert_allclose(motion.a[:, 0], REACH * (6 - 12 * s) / (2 * REACH_TIME) ** 2, atol=10 * SOLVED)


def test_free_durations_start_as_the_solutions_within_their_bounds():
    solution = solved_hop().solution
    for nominal, bounds, expected in ((0.3, (0.1, 0.5), 0.2), (0.3, (0.25, 0.5), 0.25)):
        phases = hop().schedule.phases
        flight = replace(phases[1], duration=nominal, duration_bounds=bounds)
        problem = hop(schedule=Schedule((phases[0], flight, phases[2])))
        t = prepare(problem, transcription="legendre:2", intervals=10).transcription
        start = extract(t, warm_start(t, solution).x)
        assert start.meta["durations"] == pytest.approx([0.3, expected, 0.3])
        for row in [rows[0] for rows in start.intervals if start.phase[rows[0]] == 1][1:]:
            equal = 0.3 + 0.2 * (start.t[row] - 0.3) / expected
            moving = motion_rate(solution, equal, 1e-6) * 0.2 / expected
            # Differences over 1e-6 s, in which accelerations of 1e2 / s^2 may jump.
            assert_allclose(start.v[row], moving, atol=1e-3)


def motion_rate(solution: Solution, t: float, step: float) -> np.ndarray:
    motion = motion_of(solution)
    return pin.difference(solution.model, motion(t - step), motion(t + step)) / (2 * step)


def test_the_start_is_the_problems_own():
    moved = hop(initial_v=np.array([0.1, 0, 0, 0, 0, 0, 0, 0.0]))
    t = prepare(moved, transcription="legendre:2", intervals=8).transcription
    start = warm_start(t, solved_hop().solution)
    fixed = t.lower_x == t.upper_x
    assert_array_equal(start.x[fixed], t.lower_x[fixed])


def test_soft_and_hard_landings_start_from_each_other():
    soft, hard = solved_hop(), solved(impact_hop(), "legendre:2", 8)
    for target, source in ((hard, soft), (soft, hard)):
        start = warm_start(target.transcription, source.solution)
        assert np.isfinite(start.x).all()
        assert start.x.shape == target.result.x.shape


# What it gives a solver


@pytest.mark.long
def test_a_solve_started_at_its_solution_ends_there():
    first = trajopt.solve(hop(), fixed_mesh=True)
    again = trajopt.solve(hop(), start=first, fixed_mesh=True)
    assert again.converged
    assert again.statistics.warm_start is True
    assert first.statistics.warm_start is False
    assert again.statistics.iterations < first.statistics.iterations
    assert again.statistics.objective == pytest.approx(first.statistics.objective, rel=1e-4)
    assert again.statistics.iterations <= 1  # at most the step that sees it is there


def test_multipliers_on_a_finer_grid_are_near_those_found_there():
    # The torque of a swing has costates: compared are the defects' and the rows' multipliers.
    coarse = solved(swing(), "legendre:2", 20)
    fine = solved(swing(), "legendre:2", 40)
    start = warm_start(fine.transcription, coarse.solution).multipliers
    assert start is not None
    largest = np.abs(fine.result.lam_g).max()
    # Linear interpolation between nodes, constant over the first interval: of first order there.
    assert_allclose(start.lam_g, fine.result.lam_g, atol=0.1 * largest)
    assert np.abs(start.lam_g - fine.result.lam_g).mean() < 0.02 * largest


def test_multipliers_survive_the_file(tmp_path):
    solution = trajopt.solve(hop(), fixed_mesh=True)
    loaded = Solution.load(solution.save(tmp_path / "hop.npz"))
    assert_array_equal(loaded.row_multiplier, solution.row_multiplier)
    assert_array_equal(loaded.bound_multiplier, solution.bound_multiplier)
    assert trajopt.solve(hop(), start=tmp_path / "hop.npz", fixed_mesh=True).statistics.iterations <= 1


def test_a_solution_without_multipliers_starts_too(tmp_path):
    first = trajopt.solve(hop(), fixed_mesh=True)
    bare = replace(first, row_multiplier=None, row_place=None, bound_multiplier=None)
    loaded = Solution.load(bare.save(tmp_path / "hop.npz"))
    t = solved_hop().transcription
    assert warm_start(t, loaded).multipliers is None
    again = trajopt.solve(hop(), start=loaded, fixed_mesh=True)
    assert again.converged
    assert again.statistics.iterations < first.statistics.iterations


def test_multipliers_of_other_terms_are_left_out():
    other = reach(gravity=True, terms=(AccelerationCost(weight=1.0), TorqueCost(weight=0.1)))
    first = solved(swing(), "legendre:2", 10)
    t = prepare(other, transcription="legendre:2", intervals=12).transcription
    assert warm_start(t, first.solution).multipliers is not None
    free = replace(other, schedule=Schedule((Phase(name="reach", duration=0.8, duration_bounds=(0.5, 1.0)),)))
    t = prepare(free, transcription="legendre:2", intervals=12).transcription
    assert warm_start(t, first.solution).multipliers is None  # its nodes have a clock more


# What cannot be mapped, and multipliers that are damaged


def test_another_robot_is_refused():
    t = prepare(reach()).transcription
    with pytest.raises(InputError, match=r"'hopper' has other joints than 'arm'"):
        warm_start(t, solved_hop().solution)


def test_other_phases_are_refused():
    stand = hop(schedule=Schedule((Phase(name="stance", duration=0.3, contacts=(FOOT,)),)),
                terms=(TorqueCost(weight=1.0),))  # fmt: skip
    t = prepare(stand, intervals=4).transcription
    with pytest.raises(InputError, match="phases"):
        warm_start(t, solved_hop().solution)


def test_phases_of_other_names_are_mapped_by_order():
    phases = tuple(replace(phase, name=f"{phase.name} again") for phase in hop().schedule.phases)
    terms = tuple(term for term in hop().terms if not isinstance(term, FrameHeight))
    renamed = hop(schedule=Schedule(phases), terms=terms)
    t = prepare(renamed, transcription="legendre:2", intervals=8).transcription
    assert_allclose(warm_start(t, solved_hop().solution).x, solved_hop().result.x, atol=SAME_STATE)


@pytest.mark.parametrize("start", [5, {}, b"file"])
def test_a_start_that_is_no_solution_is_refused(start):
    with pytest.raises(InputError, match="is not a solution; allowed: a Solution or the path"):
        trajopt.solve(reach(), start=start, fixed_mesh=True)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SolutionFileError, match="does not exist"):
        trajopt.solve(reach(), start=tmp_path / "none.npz", fixed_mesh=True)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"row_place": None}, "come together"),
        ({"row_multiplier": np.zeros(3)}, "row_place"),
        ({"bound_multiplier": np.full(5, np.nan)}, "NaN"),
    ],
)
def test_damaged_multipliers_are_refused(changes, words, tmp_path):
    damaged = replace(solved_hop().solution, **changes)
    with pytest.raises(InputError, match=words):
        damaged.save(tmp_path / "damaged.npz")


def test_multipliers_of_rows_that_are_nowhere_are_left_out():
    case = solved_hop()
    place = case.solution.row_place.copy()
    place[-1, 1] = 10_000
    strange = replace(case.solution, row_place=place)
    assert warm_start(case.transcription, strange).multipliers is None

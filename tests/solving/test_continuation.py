"""Sequences over a parameter and ladders of grids: what starts from what, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.command_lines import assert_refused, invoke
from tests.support.problems import REACH_TIME, inertia, limited_reach, reach
from tests.support.refusals import refusals
from tests.support.swings import BALL, FAR, POLE, past
from tests.support.swings import swing as rods_swing
from trajopt import InputError, Problem, Solution, check, continuation, solve_ladder
from trajopt.solving.continuation import NEAREST_SOLVES, Continuation, nearest
from trajopt.solving.solving import solve
from trajopt.terms import TerminalRest, TerminalState, TorqueCost, TorqueLimits, VelocityCost
from trajopt_library import problems

pytestmark = pytest.mark.long

VALUES = (0.2, 0.5, 0.8)
# One optimum, to what the solver's tolerance leaves.
SAME_OPTIMUM = 1e-6
# The swing from 0.2 to 2 rad takes more iterations than these, from 1.1 rad on fewer.
FEW_ITERATIONS = 3
ARM = ("--set", "y=0.4", "--intervals", "12")


def swing(goal: float) -> Problem:
    """The arm against gravity from rest at 0 to rest at ``goal`` rad."""
    end = np.array([goal])
    return replace(
        reach(),
        terms=(TorqueCost(weight=1.0), VelocityCost(weight=0.1), TerminalState(q=end), TerminalRest(q=end)),
        robot=reach(gravity=True).robot,
        guess=lambda t: end * np.clip(t / REACH_TIME, 0, 1),
        parameters={"goal": goal},
    )


def swings(values: tuple[float, ...] = VALUES, **settings: object) -> Continuation:
    return continuation(swing, values, **settings)


# Sequences


def test_each_value_starts_from_the_last_and_ends_at_its_own_optimum():
    found = swings(compare=True)
    assert found.success
    assert [step.value for step in found.steps] == list(VALUES)
    assert [step.origin for step in found.steps] == [None, *VALUES[:-1]]
    assert [step.solution.statistics.warm_start for step in found.steps] == [False, True, True]
    for step in found.steps:
        assert step.cold is not None
        assert step.cold.statistics.warm_start is False
        own = step.solution.statistics.objective
        assert own == pytest.approx(step.cold.statistics.objective, rel=SAME_OPTIMUM)
        assert_allclose(step.solution.q[-1], step.value, atol=SAME_OPTIMUM)


def test_totals_count_every_solve():
    found = swings(compare=True)
    figures = found.to_dict()
    iterations = [step.solution.statistics.iterations for step in found.steps]
    cold = [step.cold.statistics.iterations for step in found.steps if step.cold]
    assert figures["total"]["iterations"] == sum(iterations)
    assert figures["cold"]["iterations"] == sum(cold)
    assert figures["saved"]["iterations"] == sum(cold) - sum(iterations)
    assert figures["saved"]["wall_time_s"] == figures["cold"]["wall_time_s"] - figures["total"]["wall_time_s"]
    json.dumps(figures)


def test_without_comparison_nothing_is_said_of_savings():
    figures = swings().to_dict()
    assert figures["cold"] is None
    assert "saved" not in figures


def test_the_first_value_starts_from_a_solution_given(tmp_path):
    file = trajopt.solve(swing(0.1), fixed_mesh=True).save(tmp_path / "start.npz")
    found = swings(start=file)
    assert found.steps[0].solution.statistics.warm_start is True
    assert found.steps[0].origin is None


def test_a_step_that_fails_is_halved():
    found = swings((0.2, 2.0), max_iterations=FEW_ITERATIONS)
    assert found.success
    assert found.steps[1].value == 2.0
    assert not found.steps[1].solution.success
    between = [step for step in found.steps if not step.asked]
    assert between[0].value == pytest.approx(1.1)
    assert found.steps[-1].value == 2.0
    assert found.steps[-1].solution.converged
    assert found.solutions.keys() == {0.2, 2.0}


@pytest.mark.parametrize("halvings", [0, 2])
def test_halvings_are_bounded_and_the_own_guess_comes_last(halvings):
    found = swings((0.2, 3.0), max_iterations=FEW_ITERATIONS, max_halvings=halvings)
    assert not found.success
    failed = [step for step in found.steps if not step.solution.success]
    assert len(failed) <= halvings + 2
    assert found.steps[-1].origin is None
    assert not found.steps[-1].solution.statistics.warm_start


def test_a_sequence_goes_on_after_a_value_that_cannot_be_solved():
    found = swings((0.2, 3.0, 0.3), max_iterations=FEW_ITERATIONS, max_halvings=0)
    assert found.solutions.keys() == {0.2, 0.3}
    assert found.steps[-1].origin == 0.2


def test_a_user_who_stops_a_solve_stops_the_sequence():
    found = swings(progress=lambda figures: figures["iteration"] < 1)
    assert len(found.steps) == 1
    assert found.steps[0].solution.statistics.status == "interrupted"


def test_every_step_is_reported():
    seen: list[float] = []
    swings(on_step=lambda step: seen.append(step.value))
    assert seen == list(VALUES)


def test_functions_are_compiled_once_for_all_values(tmp_path, monkeypatch):
    monkeypatch.setenv("TRAJOPT_CACHE_DIR", str(tmp_path))
    found = continuation(swing, VALUES)
    compiled = [step.solution.statistics.functions_compiled for step in found.steps]
    assert compiled[0] > 0
    assert compiled[1:] == [0, 0]


def test_a_sequence_of_reaches_compiles_once_and_takes_fewer_iterations(tmp_path, monkeypatch):
    monkeypatch.setenv("TRAJOPT_CACHE_DIR", str(tmp_path))
    found = continuation(
        lambda value: problems.load("ur5-reach", x=value), (0.3, 0.33, 0.36), intervals=12, compare=True
    )
    assert found.success
    compiled = [step.solution.statistics.functions_compiled for step in found.steps]
    assert compiled[0] > 0
    assert compiled[1:] == [0, 0]
    for step in found.steps[1:]:
        assert step.cold is not None
        assert step.solution.statistics.iterations < step.cold.statistics.iterations


def turning(goal: float) -> Problem:
    """The rods past the ball to rest at ``goal`` rad, the links in line."""
    return past(rods_swing(end=np.array([goal, 0.0, 0.0])), BALL, FAR)


def test_motions_of_a_sequence_pass_obstacles_and_hold_at_any_time():
    found = continuation(turning, (1.0, 1.1, 1.2))
    assert found.success
    assert found.solved == (1.0, 1.1, 1.2)
    for solution in found.solutions.values():
        assert check(solution).ok
        assert solution.statistics.graded.reached is True
    first, *others = (step.solution.statistics.graded.rounds for step in found.steps)
    assert all(len(rounds) <= len(first) for rounds in others)
    assert found.to_dict()["total"]["iterations"] == sum(
        each.iterations for rounds in (first, *others) for each in rounds
    )


def test_motion_that_holds_only_at_its_points_is_no_success_of_a_sequence():
    found = continuation(swing, (0.2, 0.5), transcription="legendre:1", intervals=2)
    assert [step.solution.statistics.status for step in found.steps] == ["coarse_grid", "coarse_grid"]
    assert found.solutions.keys() == {0.2, 0.5}
    assert found.solved == ()
    assert not found.success


def test_goal_in_an_obstacle_on_the_way_of_a_sequence_is_refused():
    with pytest.raises(InputError, match="in q of terminal_state is"):
        continuation(lambda goal: past(rods_swing(end=np.array([goal, 0.0, 0.0])), POLE), (0.45,))


@pytest.mark.parametrize("values", [(), (np.nan,), (np.inf, 1.0), ("a",), None])
def test_values_that_are_no_numbers_are_refused(values):
    with pytest.raises(InputError, match=r"^values(\[0\])? of continuation"):
        continuation(swing, values)


@pytest.mark.parametrize("halvings", [-1, 1.5, True, None])
def test_halvings_that_are_no_count_are_refused(halvings):
    with pytest.raises(InputError, match="max_halvings"):
        continuation(swing, VALUES, max_halvings=halvings)


# Ladders


def test_a_ladder_ends_at_the_optimum_of_its_finest_grid():
    ladder = solve_ladder(swing(1.0), [("legendre:1", 5), ("radau:3", 9), (None, None)], compare=True)
    grids = [(one.statistics.transcription, one.n_intervals) for one in ladder.rungs]
    assert grids == [("legendre:1", 5), ("radau:3", 9), ("legendre:2", 10)]
    assert [one.statistics.warm_start for one in ladder.rungs] == [False, True, True]
    assert ladder.cold is not None
    assert ladder.solution is ladder.rungs[-1]
    direct = ladder.cold.statistics.objective
    assert ladder.solution.statistics.objective == pytest.approx(direct, rel=SAME_OPTIMUM)
    figures = ladder.to_dict()
    assert figures["total"]["iterations"] == sum(one.statistics.iterations for one in ladder.rungs)
    assert figures["cold"]["iterations"] == ladder.cold.statistics.iterations


def test_a_ladder_passes_obstacles_on_its_finest_grid():
    ladder = solve_ladder(turning(1.2), [("legendre:2", 10), ("legendre:2", 30)])
    report = check(ladder.solution)
    assert report.ok, report.failures()
    assert ladder.solution.success
    rows = ladder.solution.statistics.constraints
    assert rows > solve(rods_swing()).statistics.constraints


def test_a_rung_that_fails_starts_nothing():
    ladder = solve_ladder(swing(3.0), [("legendre:2", 8), ("legendre:2", 9)], max_iterations=1)
    assert [one.statistics.warm_start for one in ladder.rungs] == [False, False]


def test_a_user_who_stops_a_rung_stops_the_ladder():
    ladder = solve_ladder(swing(1.0), [("legendre:1", 5)] * 3, compare=True, progress=lambda _: False)
    assert len(ladder.rungs) == 1
    assert ladder.cold is None


test_ladders_that_are_none_are_refused = refusals(
    lambda rungs: solve_ladder(swing(1.0), rungs),
    ([], "no rung"),
    ([("euler", 5)], "euler"),
    ([("legendre:1", 0)], "0 intervals"),
    (["legendre:1"], "ladder"),
)


# The command line


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("warm") / "arm.npz"
    assert invoke("solve", "ur5-reach", *ARM, "--output", file).exit_code == 0
    return file


def test_solve_starts_from_a_file(arm, tmp_path):
    target = tmp_path / "next.npz"
    result = invoke("solve", "ur5-reach", *ARM, "--set", "x=0.35", "--start", arm, "--compare",
                     "--output", target, "--json")  # fmt: skip
    found = json.loads(result.stdout)
    assert result.exit_code == 0
    assert found["warm_start"] is True
    assert found["ladder"]["cold"]["iterations"] > found["iterations"]
    assert Solution.load(target).description.parameters["x"] == 0.35


def test_solve_climbs_a_ladder(tmp_path):
    result = invoke("solve", "ur5-reach", "--set", "y=0.4", "--ladder", "legendre:1@6,legendre:2@12",
                     "--output", tmp_path / "arm.npz")  # fmt: skip
    assert result.exit_code == 0
    assert "legendre:1, 6 intervals: coarse grid" in result.stdout
    assert "legendre:2, 12 intervals: solved" in result.stdout
    assert "all rungs" in result.stdout


def test_continue_writes_a_table_and_files(tmp_path):
    result = invoke("continue", "ur5-reach", *ARM, "--vary", "x=0.3:35cm:3", "--compare",
                     "--output-dir", tmp_path / "new")  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "3 of 3 values solved" in result.stdout
    assert "saved" in result.stdout
    files = sorted((tmp_path / "new").glob("*.npz"))
    assert_allclose([Solution.load(file).description.parameters["x"] for file in files], [0.3, 0.325, 0.35])


def test_continue_prints_one_json_object():
    result = invoke("continue", "ur5-reach", *ARM, "--vary", "x=0.3:0.35:2", "--json")
    found = json.loads(result.stdout)
    assert found["parameter"] == "x"
    assert found["values"] == [0.3, 0.35]
    assert [step["warm_start"] for step in found["steps"]] == [False, True]
    assert found["files"] == {}


def test_continue_ends_with_1_where_a_value_is_not_solved():
    result = invoke("continue", "ur5-reach", *ARM, "--vary", "duration=1:0.1:2", "--max-halvings", 0,
                     "--max-iterations", 8)  # fmt: skip
    assert result.exit_code == 1
    assert "1 of 2 values solved" in result.stdout


BAD = {
    "no form": (("--vary", "x"), "START:STOP:COUNT"),
    "one value": (("--vary", "x=0:1:1"), "COUNT"),
    "no number": (("--vary", "actuation=0:1:3"), "actuation"),
    "unknown": (("--vary", "q=0:1:3"), "no number 'q'"),
    "out of range": (("--vary", "x=0:99:3"), "parameter x is 99"),
    "set too": (("--vary", "x=0:1:3", "--set", "x=1"), "both varied and set"),
    "nowhere to go": (("--vary", "x=1:1:3"), "starts where it ends"),
    "no file": (("--vary", "x=0:1:3", "--start", "none.npz"), "does not exist"),
    "no folder": (("--vary", "x=0:1:3", "--output-dir", __file__), "not a folder"),
}


@pytest.mark.parametrize(("arguments", "words"), BAD.values(), ids=BAD.keys())
def test_bad_input_of_continue_is_refused(arguments, words):
    assert_refused(invoke("continue", "ur5-reach", *arguments), words)


BAD_SOLVE = {
    "no ladder": (("--ladder", "fine"), "SCHEME@INTERVALS"),
    "unknown scheme": (("--ladder", "euler@5"), "euler"),
    "too coarse": (("--ladder", "legendre:1@0"), "0 intervals"),
    "two grids": (("--ladder", "legendre:1@5", "--intervals", "9"), "single mesh"),
    "nothing to compare": (("--compare",), "nothing to compare"),
    "no file": (("--start", "none.npz"), "does not exist"),
}


@pytest.mark.parametrize(("arguments", "words"), BAD_SOLVE.values(), ids=BAD_SOLVE.keys())
def test_bad_starts_of_solve_are_refused(arguments, words, tmp_path):
    assert_refused(invoke("solve", "ur5-reach", *arguments, "--output", tmp_path / "arm.npz"), words)


def test_a_solution_of_another_robot_is_refused(arm, tmp_path):
    result = invoke("solve", "hopper-hop", "--start", arm, "--output", tmp_path / "hop.npz")
    assert_refused(result, "'ur5' has other joints")


# The nearest value


def test_nearest_value_is_just_below_the_largest_that_the_torque_allows():
    """At full torque one way, then the other, the arm turns by torque T^2 / (4 inertia)."""
    torque = 2.0

    def turn(goal: float) -> Problem:
        end = np.array([goal])
        limits = TorqueLimits(limit=np.array([torque]))
        return replace(
            limited_reach(torque),
            terms=(TorqueCost(weight=1.0), limits, TerminalState(q=end), TerminalRest(q=end)),
            guess=lambda t: end * np.clip(t / REACH_TIME, 0, 1),
        )

    largest = torque * REACH_TIME**2 / (4 * inertia())
    seen: list[float] = []
    step = nearest(turn, 0.1 * largest, 2 * largest, on_step=lambda one: seen.append(one.value))
    assert step is not None
    assert step.solution.converged
    assert len(seen) == NEAREST_SOLVES
    assert seen[:2] == [0.1 * largest, 2 * largest]
    # The last bisection leaves this; a torque that switches within an interval loses a little more.
    left = 1.9 * largest / 2 ** (NEAREST_SOLVES - 2)
    assert largest - 2 * left < step.value <= largest * (1 + SAME_OPTIMUM)


def test_nearest_is_the_value_asked_for_where_that_is_solved_from_the_first():
    step = nearest(swing, 0.2, 0.5)
    assert step is not None
    assert step.value == 0.5
    assert step.solution.statistics.warm_start is True


def test_nearest_is_nothing_where_the_first_value_is_not_solved():
    assert nearest(swing, 2.0, 3.0, max_iterations=1) is None


def test_a_user_who_stops_a_solve_stops_the_search():
    seen: list[float] = []
    found = nearest(swing, 0.2, 0.5, progress=lambda _: False, on_step=lambda one: seen.append(one.value))
    assert found is None
    assert seen == [0.2]


def test_command_line_says_and_writes_the_nearest_value(tmp_path):
    target = tmp_path / "short-duration=0.1.npz"
    short = ("--set", "duration=0.1", "--intervals", "8")
    result = invoke("solve", "ur5-reach", *short, "--nearest", "duration", "--output", target, "--json")
    assert result.exit_code == 1, result.output
    found = json.loads(result.stdout)
    entry = found["nearest"]
    assert entry["parameter"] == "duration"
    assert 0.1 < entry["value"] < 0.5
    assert found["file"] == str(target)
    near = Solution.load(entry["file"])
    assert near.description.parameters["duration"] == entry["value"]
    assert near.converged
    assert entry["file"] == str(tmp_path / f"short-duration={entry['value']:.4g}.npz")


@pytest.mark.parametrize(
    ("problem", "words", "expected"),
    [
        ("ur5-reach", ("--set", "duration=0.1", "--nearest", "heigt"), "has no number 'heigt'"),
        ("arm-reach", ("--set", "robot=panda", "--nearest", "robot"), "has no number 'robot'"),
        ("ur5-reach", ("--nearest", "duration"), "has no value to come near"),
        ("ur5-reach", ("--set", "duration=1.5", "--nearest", "duration"), "is the default"),
        ("ur5-reach", ("--set", "duration=0.1", "--nearest", "duration", "--smallest"), "another way"),
        (
            "ur5-reach",
            ("--set", "duration=0.1", "--nearest", "duration", "--ladder", "legendre:1@5"),
            "another",
        ),
    ],
)
def test_nearest_of_what_cannot_be_searched_is_refused(problem, words, expected):
    assert_refused(invoke("solve", problem, *words), expected)

"""Settings chosen from a measured front: what is predicted, what is tried, and what is reached."""

from __future__ import annotations

import csv
import json
import math

import pytest
from numpy.testing import assert_allclose

from tests.support.command_lines import invoke
from tests.support.problems import hop, reach
from trajopt.certify.accuracy.measures import measure
from trajopt.cli.aim import TIME
from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.solving.rounds import phase_errors, unknowns_on_mesh
from trajopt.study.choosing.choice import choices_by_time, choose_for_accuracy, front_for
from trajopt.study.choosing.solve_to import solve_to_accuracy, solve_within
from trajopt.study.sweep.calibration import Load
from trajopt.study.sweep.front import load_front, packaged_fronts
from trajopt.study.sweep.likeness import motion_kind

pytestmark = pytest.mark.long

# Points of a made-up front: scheme, intervals by natural time, solver, Hessian, time in s, error over length,
# part of the runs that were solved.
POINTS = (
    ("legendre:1", 1.0, "ipopt", "exact", 0.01, 1e-1, 1.0),
    ("legendre:2", 2.0, "fatrop", "exact", 0.02, 1e-2, 1.0),
    ("legendre:2", 4.0, "ipopt", "exact", 0.04, 1e-3, 1.0),
    ("legendre:3", 4.0, "sqp", "gauss-newton", 0.05, 1e-4, 0.5),
    ("legendre:3", 8.0, "ipopt", "exact", 0.20, 1e-6, 1.0),
)
VARIABLES = 100.0


@pytest.fixture
def front(tmp_path):
    """A front whose default is its third point."""
    file = tmp_path / "settings.csv"
    common = {
        "problem": "made-up",
        "robot": "none",
        "kind": "arm",
        "n_velocities": 6,
        "natural_time_s": 0.2,
        "length_m": 0.4,
        "tolerance": 1e-6,
        "cone": "own",
        "model": "full",
        "start": "cold",
        "variables": VARIABLES,
        "calibration_s": Load().seconds(3),
    }
    rows = [
        common
        | {
            "transcription": scheme,
            "intervals": 10,
            "intervals_per_natural_time": density,
            "solver": solver,
            "hessian": hessian,
            "time_s": seconds,
            "relative_time": seconds / POINTS[2][4],
            "error_m": 0.4 * error,
            "relative_error": error,
            "success_rate": success,
            "is_default": int(index == 2),
        }
        for index, (scheme, density, solver, hessian, seconds, error, success) in enumerate(POINTS)
    ]
    with file.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return file


def test_fastest_setting_that_is_accurate_enough_is_chosen(front):
    problem = reach()
    choice = choose_for_accuracy(problem, 2e-3 * problem.robot.length, front=front)
    assert choice.measured.setting.transcription == "legendre:2"
    assert choice.solver == {"solver": "ipopt", "hessian": "exact", "tolerance": 1e-6}
    assert_allclose(choice.predicted_error, 1e-3 * problem.robot.length)


def test_intervals_follow_the_natural_time_of_the_robot(front):
    problem = hop()
    choice = choose_for_accuracy(problem, 2e-3 * problem.robot.length, front=front)
    expected = round(4.0 * problem.schedule.duration / Units(problem.robot).time)
    assert sum(choice.mesh.counts) == max(expected, 3)


def test_time_is_predicted_by_unknowns_and_the_speed_of_the_machine(front, monkeypatch):
    problem = reach()
    monkeypatch.setattr(Load, "seconds", lambda self, loads=1: 3 * load_front(front).calibration)
    choice = choose_for_accuracy(problem, 2e-3 * problem.robot.length, front=front)
    assert_allclose(choice.predicted_time, 3 * 0.04 * unknowns_on_mesh(problem, choice.mesh) / VARIABLES)


def test_most_accurate_setting_is_chosen_for_what_none_reaches(front):
    choice = choose_for_accuracy(reach(), 1e-12, front=front)
    assert choice.measured.relative_error == 1e-6


def test_settings_that_often_fail_are_not_chosen(front):
    problem = reach()
    choice = choose_for_accuracy(problem, 2e-4 * problem.robot.length, front=front)
    assert choice.measured.relative_error == 1e-6


def test_only_allowed_settings_are_chosen(front):
    choice = choose_for_accuracy(reach(), 1e-12, front=front, where=lambda s: s.solver == "fatrop")
    assert choice.measured.setting.solver == "fatrop"


def test_settings_for_a_budget_come_fastest_first(front):
    choices = choices_by_time(reach(), front=front)
    times = [choice.predicted_time for choice in choices]
    assert times == sorted(times)
    assert [choice.measured.relative_error for choice in choices] == [1e-1, 1e-2, 1e-3, 1e-6]


def test_what_a_solve_took_corrects_what_is_predicted_of_the_others(front, monkeypatch):
    """On a machine that seems a million times slower than it is the fastest setting tells how fast it is."""
    monkeypatch.setattr(Load, "seconds", lambda self, loads=1: 1e6 * load_front(front).calibration)
    found = solve_within(reach(), 60.0, front=front)
    assert len(found.rounds) > 1
    assert found.choices[-1].measured.relative_error == 1e-6


def test_a_table_with_compile_levels_is_read_at_that_of_its_default(front, tmp_path):
    header, *lines = front.read_text().splitlines()
    old = [f"{header},compile", *(f"{line},{level}" for line in lines for level in ("none", "quick"))]
    old = [line.replace(",1,none", ",0,none") for line in old]
    (tmp_path / "old.csv").write_text("\n".join(old) + "\n")
    assert load_front(tmp_path / "old.csv") == load_front(front)


@pytest.mark.parametrize("target", [1e-2, 1e-5])
def test_accuracy_is_reached_as_measured_anew(front, tmp_path, target):
    found = solve_to_accuracy(hop(), target, front=front)
    assert found.reached
    assert max(phase_errors(measure(found.solution.save(tmp_path / "hop.npz")))) <= target
    assert found.solution.statistics.more["aimed"]["wanted"] == target
    assert found.solution.statistics.more["aimed"]["reached"] is True


def test_choice_that_falls_short_is_refined_from_its_solution(front):
    found = solve_to_accuracy(hop(), 1e-7, front=front)
    assert found.reached
    assert found.rounds[0].mesh == found.choices[0].mesh
    assert found.rounds[0].error > 1e-7
    assert len(found.rounds) > 1


def test_budget_is_kept_and_what_is_left_is_used(front):
    found = solve_within(reach(), 60.0, front=front)
    assert found.reached
    assert found.spent <= 60.0
    assert found.choices[-1].measured.relative_error == 1e-6
    assert found.why == "the most accurate measured setting is reached"


def test_budget_too_small_for_any_solve_says_so(front):
    found = solve_within(hop(), 1e-6, front=front)
    assert not found.reached
    assert found.why == "nothing was solved in that time"
    assert found.solution.statistics.status == "time_limit"


def test_accuracy_and_budget_must_be_positive_numbers(front):
    for value in (0.0, -1.0, math.nan, math.inf, "1"):
        with pytest.raises(
            InputError, match=r"^accuracy of solve_to_accuracy is .*; allowed: a finite number > 0"
        ):
            solve_to_accuracy(reach(), value, front=front)
        with pytest.raises(InputError, match=r"^budget of solve_within is .*; allowed: a finite number > 0"):
            solve_within(reach(), value, front=front)


def test_front_that_is_missing_is_refused_with_those_that_are_known(tmp_path):
    with pytest.raises(InputError, match=r"cannot read the front .*none.csv"):
        choose_for_accuracy(reach(), 1e-3, front=tmp_path / "none.csv")


def test_kind_of_motion_is_read_from_the_problem():
    assert motion_kind(reach()) == "arm"
    assert motion_kind(hop()) == "flight"


def test_packaged_front_is_of_the_same_kind_of_motion():
    for problem in (reach(), hop()):
        name, found = front_for(problem)
        assert name in packaged_fronts()
        assert found.kind == motion_kind(problem)


@pytest.mark.parametrize(("text", "seconds"), [("0.5s", 0.5), ("500ms", 0.5), ("2min", 120.0), ("3", 3.0)])
def test_times_are_read_with_their_units(text, seconds):
    assert_allclose(TIME.convert(text, None, None), seconds)


def run(*arguments):
    return invoke("solve", "hopper-hop", *arguments)


def test_command_reaches_an_accuracy_and_reports_it(front, tmp_path):
    done = run("--accuracy", "1e-3", "--front", front, "--json", "--output", tmp_path / "hop.npz")
    assert done.exit_code == 0, done.stderr
    aimed = json.loads(done.stdout)["aimed"]
    assert aimed["reached"] is True
    assert aimed["error_m"] <= 1e-3
    assert max(phase_errors(measure(tmp_path / "hop.npz"))) <= 1e-3


def test_command_that_misses_its_goal_ends_with_one(front, tmp_path):
    done = run("--budget", "1ms", "--front", front, "--output", tmp_path / "hop.npz")
    assert done.exit_code == 1
    assert "budget of 0.001 s not reached" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--accuracy", "1e-3", "--budget", "1s"), "--accuracy and --budget are both given"),
        (("--accuracy", "1e-3", "--intervals", "20"), "--intervals is given with --accuracy or --budget"),
        (("--budget", "1s", "--tolerance", "1e-3"), "--tolerance is given with --accuracy or --budget"),
        (("--budget", "soon"), "'soon' is not a time above 0, allowed: such as 0.5s, 500ms or 2min"),
        (("--accuracy", "-1"), "'-1' is not a length above 0, allowed: such as"),
        (("--accuracy", "nan"), "'nan' is not a length above 0, allowed: such as"),
        (("--front", "solo12-jump"), "--front has no effect here; allowed: with --accuracy or --budget"),
        (("--accuracy", "1e-3", "--front", "nowhere.csv"), "cannot read the front nowhere.csv"),
    ],
)
def test_bad_goals_are_refused_in_one_line(tmp_path, arguments, message):
    done = run(*arguments, "--output", tmp_path / "hop.npz")
    assert done.exit_code == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1

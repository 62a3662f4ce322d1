"""Published optima are found; our half of the comparison with Crocoddyl, which is not installed here."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from scripts.documents import written
from scripts.peers import problems, report, serve
from scripts.peers.report import CROCODDYL, OURS, Measured, Setting
from scripts.peers.tasks import ANYMAL_FEET, GAITS, KNOT, SOLO_JUMP, TASKS, Gait, Jump
from tests.support.command_lines import invoke
from trajopt.errors import InputError
from trajopt.problem.catalogue import published_optima
from trajopt.robot.kinematics import contact_positions
from trajopt.solving.solving import solve
from trajopt.study.published import compared
from trajopt.terms import TerminalLinear

OPTIMA = {one.name: one for one in published_optima()}


@pytest.mark.parametrize("name", OPTIMA)
def test_a_published_optimum_is_found_within_its_tolerance(name):
    (comparison,) = compared([OPTIMA[name]])
    assert comparison.converged
    assert comparison.agrees, f"{comparison.found} is {comparison.apart:+.1e} from {comparison.published}"


@pytest.mark.parametrize("name", ["cart-pole", "two-link arm", "pendulum"])
def test_a_published_optimum_does_not_depend_on_the_mesh(name):
    optimum = OPTIMA[name]
    values = [
        optimum.value(trajopt.solve(optimum.build(), transcription=scheme, intervals=intervals))
        for scheme, intervals in (("legendre:2", 120), ("legendre:3", 60), ("radau:3", 60))
    ]
    assert_allclose(values, values[1], rtol=optimum.tolerance)


@pytest.mark.long
def test_the_command_prints_every_optimum_and_its_json():
    table, data = invoke("bench", "outside"), invoke("bench", "outside", "--json")
    assert table.exit_code == data.exit_code == 0
    assert all(name in table.stdout for name in OPTIMA)
    found = json.loads(data.stdout)
    assert {entry["name"] for entry in found} == set(OPTIMA)
    assert all(entry["agrees"] and entry["source"] for entry in found)


@pytest.mark.parametrize(
    ("position", "velocity", "value", "message"),
    [
        ([[1.0]], [[1.0, 0.0]], [0.0], r"shapes \(1, 1\) and \(1, 2\)"),
        ([[1.0]], [[0.0]], [0.0, 1.0], "and 2 values"),
        ([[0.0]], [[0.0]], [1.0], "a row of TerminalLinear is zero|a row of .* is zero"),
        ([[1.0, 0.0]], [[0.0, 0.0]], [1.0], "has 2 columns; allowed: 1"),
    ],
)
def test_terminal_rows_of_wrong_shape_are_refused(position, velocity, value, message):

    problem = OPTIMA["rest to rest"].build()

    def ends_on(**row):
        term = TerminalLinear(**{name: np.array(values) for name, values in row.items()})
        trajopt.solve(replace(problem, terms=(*problem.terms[:2], term)))

    with pytest.raises(InputError, match=message):
        ends_on(position=position, velocity=velocity, value=value)


# Knots of the problems that Crocoddyl's example builds, without impulses, which have no duration.
KNOTS = {"walk": 104, "trot": 54, "pace": 60, "bound": 60, "jump": 60}
# Of footholds, to the solver's tolerance, m.
SOLVED = 1e-5


@pytest.mark.parametrize("name", KNOTS)
def test_schedules_last_as_long_as_crocoddyls(name: str) -> None:
    assert problems.build(TASKS[name]).schedule.duration == pytest.approx(KNOTS[name] * KNOT)


@pytest.mark.parametrize("gait", GAITS, ids=lambda gait: gait.name)
def test_all_feet_stand_between_the_steps_of_a_block_and_each_swings_once(gait: Gait) -> None:
    phases = problems.build(gait).schedule.phases
    steps = [feet for block in gait.blocks for feet in block]
    swinging = [tuple(foot for foot in ANYMAL_FEET if foot not in phase.contacts) for phase in phases]
    assert [set(feet) for feet in swinging if feet] == [set(feet) for feet in steps]
    assert sorted(foot for feet in steps for foot in feet) == sorted(ANYMAL_FEET)
    assert [phase.duration for phase, feet in zip(phases, swinging, strict=True) if not feet] == (
        [gait.support] * len(gait.blocks)
    )


def test_first_steps_of_the_walk_are_half_as_long() -> None:
    problem = problems.build(TASKS["walk"])
    begin = contact_positions(problem.robot, problem.initial_q)
    lengths = {
        foot: float((place - begin[foot])[0])
        for phase in problem.schedule.phases
        for foot, place in phase.footholds.items()
    }
    assert lengths == pytest.approx({"RH": 0.125, "RF": 0.125, "LH": 0.25})


def test_short_phases_are_one_interval() -> None:
    problem = problems.build(TASKS["trot"])
    assert problems.mesh(problem, "legendre:2", 3).counts == (1, 3, 1, 3)


def test_our_half_describes_the_robot() -> None:
    described = serve.describe("jump")
    assert sum(described["masses"]) == pytest.approx(problems.anymal().mass, rel=1e-6)
    assert len(described["posture"]) == 19


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS.values(), ids=lambda task: task.name)
def test_tasks_are_solved_on_a_coarse_mesh(task: Gait | Jump) -> None:
    problem = problems.build(task)
    mesh = problems.mesh(problem, "legendre:3", 3)
    solution = solve(problem, mesh=mesh, options={"linear_solver": "stages"}, judge=False)
    assert solution.success
    if isinstance(task, Gait):
        begin = contact_positions(problem.robot, problem.initial_q)
        moved = contact_positions(problem.robot, solution.q[-1])
        for foot in task.blocks[-1][-1]:
            assert moved[foot] - begin[foot] == pytest.approx([task.length, 0.0, 0.0], abs=SOLVED)


def measured(side: str, method: str, size: float, seconds: float, error: float) -> Measured:
    detail = "stages" if side == OURS else "1"
    setting = Setting(task="trot", side=side, method=method, size=size, detail=detail)
    return Measured(
        setting=setting, seconds=[seconds], iterations=9, solved=True, end=error, largest=error, torque=40.0
    )


def test_the_fastest_mesh_at_a_hundredth_of_the_error_is_compared() -> None:
    theirs = measured(CROCODDYL, "FDDP", 10.0, 0.1, 1e-3)
    coarse, fit, fine = (
        measured(OURS, "legendre:3", size, seconds, error)
        for size, seconds, error in ((2, 0.05, 1e-4), (4, 0.08, 1e-5), (6, 0.2, 1e-6))
    )
    found = [theirs, coarse, fine, fit]
    assert report.chosen(found, "trot") is fit
    assert list(report.summary(found, ["trot"]))[-1].endswith("| 0.80 | 0.80 |  |")
    assert report.chosen([theirs, coarse], "trot") is None


def test_measurements_are_read_as_they_were_written(tmp_path: Path) -> None:
    found = [measured(CROCODDYL, "FDDP", 2.5, 0.1, 1e-3), measured(OURS, "legendre:3", 4.0, 0.08, math.inf)]
    report.write_csv(found, tmp_path / "found.csv")
    assert report.read_csv(tmp_path / "found.csv") == found


def test_with_limits_of_torques_the_solver_for_them_is_compared() -> None:
    found = [measured(CROCODDYL, method, 10.0, 1.0, 1e-3) for method in ("FDDP", "BoxFDDP")]
    assert report.example(found, "trot").setting.method == "BoxFDDP"
    assert SOLO_JUMP.torque_limit is not None


def test_sections_of_documents_are_replaced() -> None:
    text = "a\n<!-- x -->\nold\n<!-- end of x -->\nb\n"
    assert written(text, "x", "new") == "a\n<!-- x -->\n\nnew\n<!-- end of x -->\nb\n"


def test_of_each_length_of_knots_the_fastest_mesh_at_its_error_is_compared() -> None:
    coarse, long = (
        measured(CROCODDYL, "FDDP", size, 0.1, error) for size, error in ((20.0, 1e-2), (10.0, 1e-3))
    )
    fast, fine = (
        measured(OURS, "legendre:2", size, seconds, error)
        for size, seconds, error in ((2, 0.05, 5e-3), (4, 0.08, 1e-3))
    )
    titles, _, row = report.knots([coarse, long, fast, fine], ["trot"])
    assert (titles, row) == ("| task | 20 ms | 10 ms |", "| trot | 0.50 | 0.80 |")

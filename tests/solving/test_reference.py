"""Converged references: when two meshes agree, what is said when they do not, and the commands."""

import json
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.command_lines import invoke
from tests.support.problems import lean, reach
from trajopt.certify.accuracy.measures import measure
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.schedule import end_of, middle_of
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.reference import Agreement, NoReferenceError, converged_reference, in_other_optimum
from trajopt.terms import AccelerationCost, FrameDirection, PostureCost, TorqueCost
from trajopt.terrain.flat import FlatGround

TURN = 1.2  # rad
# On a busy machine a solve, or what comes after it, is what the time ends.
TIME = r"no reference: (the time is up|.* is not solved \(time limit\))"


def swing() -> Problem:
    """A bar lifted against gravity with little torque: no polynomial in time."""
    return reach(gravity=True, terms=(TorqueCost(weight=1.0),))


def bar() -> Robot:
    """A bar that turns about y, without gravity."""
    model = pin.Model()
    model.name = "bar"
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.1, 0.1, 0.5), pin.SE3.Identity())
    model.addFrame(pin.Frame("bar", joint, 0, pin.SE3(np.eye(3), np.array([0, 0, 0.5])), pin.OP_FRAME))
    model.gravity = pin.Motion.Zero()
    return Robot.from_model(model, reference=np.zeros(1), name="bar")


def either_way(sign: float) -> Problem:
    """Turn far away from the downward direction, either way: one optimum each, chosen by the guess."""
    away = FrameDirection(
        frame="bar", axis=(0, 0, 1), direction=(0.05, 0, -1), angle=np.pi - TURN, at=end_of("turn")
    )
    return Problem(
        name="either-way",
        robot=bar(),
        schedule=Schedule((Phase(name="turn", duration=1.0),)),
        terrain=FlatGround(),
        initial_q=np.zeros(1),
        initial_v=np.zeros(1),
        terms=(AccelerationCost(weight=1.0), PostureCost(weight=0.1), away),
        guess=lambda t: np.array([sign * TURN * t]),
        default_intervals=6,
    )


def test_reference_agrees_and_says_how_it_was_found():
    seen = []
    found = converged_reference(swing(), progress=seen.append)
    assert tuple(seen) == found.rungs
    assert [rung.scheme for rung in found.rungs[:2]] == ["legendre:2", "legendre:3"]
    assert [rung.intervals for rung in found.rungs[:3]] == [10, 10, 20]
    assert abs(found.agreement.objective_gap) <= 1e-5
    assert found.agreement.farthest <= 1e-3 * 0.5
    assert found.rungs[-1].apart == found.agreement
    assert found.rungs[-1].intervals == found.solution.n_intervals
    described = json.loads(json.dumps(found.solution.statistics.more["reference"], allow_nan=False))
    assert described["rungs"][-1]["objective"] == found.solution.statistics.objective
    assert "the last two agree to" in str(found)


def test_reference_of_least_acceleration_is_the_cubic():
    """12 theta^2 / T^3 is the least integral of the squared acceleration from rest to rest."""
    found = converged_reference(reach())
    plan = found.solution
    s = plan.t / plan.t[-1]
    assert_allclose(plan.q[:, 0], plan.q[-1, 0] * (3 * s**2 - 2 * s**3), atol=1e-9)
    coarse = trajopt.solve(reach(), intervals=3)
    assert measure(coarse, plan).distance < 1e-9
    assert abs(measure(coarse, plan).objective_gap) < 1e-9


@pytest.mark.long
def test_distance_to_the_reference_falls_with_the_step():
    found = converged_reference(lean(), agreement=Agreement(objective=1e-7, distance=1e-4)).solution
    gaps = [measure(trajopt.solve(lean(), transcription="legendre:1", intervals=n), found) for n in (4, 8)]
    assert gaps[1].distance < 0.5 * gaps[0].distance
    assert gaps[1].open_loop < 0.5 * gaps[0].open_loop


@pytest.mark.long
def test_budget_ends_the_climb_and_names_the_agreement():
    strict = Agreement(objective=1e-15, distance=1e-15)
    words = r"more than 600 variables; the last two meshes agree to .* m"
    with pytest.raises(NoReferenceError, match=words) as caught:
        converged_reference(swing(), agreement=strict, max_unknowns=600)
    assert len(caught.value.rungs) > 2
    with pytest.raises(NoReferenceError, match=TIME):
        converged_reference(swing(), agreement=strict, max_time=0.2)


def test_mesh_that_is_not_solved_is_named():
    goal = replace(swing(), terms=(*swing().terms, FrameDirection(
        frame="universe", axis=(0, 0, 1), direction=(0, 0, -1), angle=0.1, at=middle_of("reach"),
    )))  # fmt: skip
    with pytest.raises(NoReferenceError, match="legendre:2 with 10 intervals is not solved"):
        converged_reference(goal)


def test_bad_bounds_are_refused():
    with pytest.raises(InputError, match="objective of Agreement is 0"):
        Agreement(objective=0.0)
    with pytest.raises(InputError, match="distance of Agreement is inf"):
        Agreement(distance=np.inf)
    with pytest.raises(InputError, match="max_time is -1"):
        converged_reference(reach(), max_time=-1.0)
    with pytest.raises(InputError, match="unknown transcription"):
        converged_reference(reach(), scheme="legendre:9")


def test_solutions_in_different_optima_are_told_from_those_on_different_meshes():
    left, right = (trajopt.solve(either_way(sign), intervals=n) for sign, n in ((-1.0, 6), (1.0, 12)))
    assert left.converged
    assert right.converged
    assert left.q[-1, 0] < 0 < right.q[-1, 0]
    assert in_other_optimum(either_way(-1.0), left, right)
    finer = trajopt.solve(either_way(1.0), intervals=24)
    assert not in_other_optimum(either_way(1.0), right, finer)


@pytest.mark.long
def test_commands_make_a_reference_and_check_against_it(tmp_path):
    made, plan = tmp_path / "reference.npz", tmp_path / "plan.npz"
    result = invoke("bench", "reference", "ur5-reach", "--output", made, "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["file"] == str(made)
    assert "30 intervals" in result.stderr
    assert invoke("solve", "ur5-reach", "--output", plan).exit_code == 0
    plain = json.loads(invoke("check", plan, "--json").stdout)
    full = json.loads(invoke("check", plan, "--reference", made, "--json").stdout)
    found = full.pop("accuracy")
    assert full == plain
    assert abs(found["objective_gap"]) < 1e-4
    assert found["distance"] < 1e-3
    assert found["open_loop"] == pytest.approx(measure(plan).open_loop)
    text = invoke("check", plan, "--accuracy").stdout
    assert "local error of one interval" in text
    assert "reference" not in text


def test_command_that_finds_none_writes_no_file(tmp_path):
    made = tmp_path / "reference.npz"
    arguments = ["bench", "reference", "ur5-reach", "--distance", "1e-15", "--max-time", "0.5"]
    result = invoke(*arguments, "--output", made)
    assert result.exit_code == 1
    assert re.search(TIME, result.stderr)
    assert not made.exists()

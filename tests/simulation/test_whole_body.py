"""Plans in MuJoCo with the whole-body controller: pushes, balance on a point, arms, and what is reported."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.support.command_lines import invoke
from tests.support.solved_problems import motion
from trajopt import Solution
from trajopt.errors import InputError
from trajopt.simulation.simulate import simulate

# A push to the side for a tenth of the motion, N: an eighth of the weight.
PUSH = 20.0


@pytest.fixture(scope="module")
def trot() -> Solution:
    return motion("quadruped-trot", robot="go2")


@pytest.mark.slow
@pytest.mark.parametrize("push", [PUSH, -PUSH])
def test_a_push_that_overturns_single_joints_is_taken_by_the_whole_body(trot: Solution, push: float) -> None:
    joints = simulate(trot, cycles=10, push=push).report
    whole = simulate(trot, cycles=10, push=push, controller="whole-body").report
    assert joints.fell
    assert whole.passed, whole.failures
    assert whole.controller is not None
    assert whole.controller.ticks == sum(whole.controller.relaxed.values())


@pytest.mark.slow
def test_feet_step_after_a_push_of_a_quarter_of_the_weight(trot: Solution) -> None:
    for push in (2 * PUSH, -2 * PUSH):
        report = simulate(trot, cycles=6, push=push, controller="whole-body").report
        assert not report.fell
        assert report.base_error_max is not None
        assert report.base_error_max > 0.1  # it went aside, and stepped


@pytest.mark.slow
def test_cycles_end_where_the_command_leads(trot: Solution) -> None:
    report = simulate(trot, cycles=10, controller="whole-body").report
    assert report.base_error_end is not None
    assert report.base_error_end < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("offset", [(0.0, 0.015, 0.0), (-0.02, 0.0, 0.0)])
def test_feet_land_beside_their_footholds_where_the_centre_of_mass_is_not_the_models(
    trot: Solution, offset: tuple[float, float, float]
) -> None:
    report = simulate(trot, cycles=5, com_offset=offset, controller="whole-body").report
    assert report.passed, report.failures


@pytest.mark.slow
def test_a_hopper_lands_and_balances_on_one_point() -> None:
    plan = motion("hopper-hop")
    assert simulate(plan, controller="whole-body").report.passed
    assert not simulate(plan).report.passed


@pytest.mark.slow
def test_a_biped_with_point_feet_steps_up_over_a_line_of_two_heights() -> None:
    plan = motion("biped-step-up", robot="bolt")
    report = simulate(plan, controller="whole-body").report
    assert report.passed, report.failures
    assert not simulate(plan).report.passed


@pytest.mark.slow
def test_a_barrel_roll_lands_on_two_feet_of_a_line_and_tips_onto_the_others() -> None:
    plan = motion("quadruped-barrel-roll", robot="a1")
    report = simulate(plan, controller="whole-body").report
    assert report.passed, report.failures


@pytest.mark.slow
@pytest.mark.parametrize(
    ("problem", "robot"), [("quadruped-bound", "solo12"), ("quadruped-gallop", "anymal_c")]
)
def test_ten_cycles_of_gaits_with_flights_end_within_20_mm(problem: str, robot: str) -> None:
    plan = motion(problem, robot=robot)
    report = simulate(plan, cycles=10, controller="whole-body").report
    assert not report.fell
    assert report.base_error_end is not None
    assert report.base_error_end < 0.02


@pytest.mark.slow
def test_other_masses_and_friction_are_tracked_too(trot: Solution) -> None:
    for settings in ({"mass_scale": 1.2}, {"mass_scale": 0.8}, {"friction_scale": 0.7}, {"noise": 0.01}):
        report = simulate(trot, cycles=3, controller="whole-body", **settings).report
        assert report.passed, (settings, report.failures)


@pytest.mark.long
def test_an_arm_is_tracked() -> None:
    plan = motion("ur5-reach")
    report = simulate(plan, controller="whole-body").report
    assert report.passed, report.failures


@pytest.mark.long
def test_ticks_are_reported(trot: Solution, tmp_path: Path) -> None:
    file = trot.save(tmp_path / "trot.npz")
    done = invoke("simulate", file, "--controller", "whole-body")
    assert done.exit_code == 0, done.stderr
    assert "by relaxation, nothing" in done.stdout
    assert re.search(r"ticks, slack +0  natural", done.stdout)
    found = json.loads(invoke("simulate", file, "--controller", "whole-body", "--json").stdout)
    assert found["controller"]["relaxed"] == {"nothing": found["controller"]["ticks"]}
    assert found["controller"]["slack"] == 0.0
    assert json.loads(invoke("simulate", file, "--json").stdout)["controller"] is None


@pytest.mark.parametrize(
    ("settings", "allowed"),
    [({"kp": 2.0, "controller": "whole-body"}, "joints"), ({"qp_solver": "osqp"}, "whole-body")],
)
def test_settings_of_the_other_controller_are_refused(trot: Solution, settings: dict, allowed: str) -> None:
    with pytest.raises(InputError, match=f"allowed: with the controller '{allowed}'"):
        simulate(trot, **settings)


@pytest.mark.long
def test_what_the_controller_asked_for_is_in_the_simulated_solution(trot: Solution, tmp_path: Path) -> None:
    found = simulate(trot, controller="whole-body")
    asked, record = found.record.requests, found.record
    assert asked is not None
    assert asked.forces.shape == record.force.shape
    weight = found.scene.units.weight
    assert asked.forces[:, :, 2].sum(axis=1).mean() == pytest.approx(weight, rel=0.02)
    off = np.linalg.norm(asked.forces[:, :, :3] - record.force[:, :, :3], axis=2)
    assert np.median(off) < 0.02 * weight  # most of the time it gets what it asks for
    # It leads the centre of mass while something stands: always, but for ticks in which feet are late.
    standing = (asked.forces != 0).any(axis=(1, 2))
    assert_array_equal(np.isfinite(asked.com).all(axis=1), standing)
    assert standing.mean() > 0.95
    swinging = ~found.timeline.active & (np.linalg.norm(record.force, axis=2) == 0.0)
    goals = np.linalg.norm(asked.feet - record.feet, axis=2)[swinging & np.isfinite(asked.feet[:, :, 0])]
    assert goals.size
    assert goals.max() < 0.05 * found.report.reach
    saved = Solution.load(found.as_solution().save(tmp_path / "sim.npz"))
    assert saved.asked_force is not None
    assert saved.asked_force.shape == saved.f.shape
    np.testing.assert_array_equal(saved.foot_goal, found.as_solution().foot_goal)
    assert simulate(trot).as_solution().asked_force is None


def test_bad_words_are_refused(trot: Solution, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is 'wholebody'; .*did you mean whole-body"):
        simulate(trot, controller="wholebody")
    with pytest.raises(InputError, match="qp_solver of SimulationSettings is 'proxq'; did you mean proxqp"):
        simulate(trot, controller="whole-body", qp_solver="proxq")
    assert invoke("bench", "suite", "--controller", "whole-body").exit_code == 2
    assert np.isfinite(trot.q).all()

"""Simulations with controllers of one's own: what they are given, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_array_equal

import trajopt
from tests.support.command_lines import assert_refused, invoke
from trajopt import Solution
from trajopt.control import Tracker, TrackerGains
from trajopt.errors import InputError
from trajopt.simulation.settings import TorqueController
from trajopt.simulation.simulate import simulate

pytestmark = pytest.mark.long

RATE = 200.0  # Hz


@pytest.fixture(scope="module")
def reach() -> Solution:
    return trajopt.solve(trajopt.load("arm-reach", robot="ur5"), fixed_mesh=True)


class Springs:
    """Springs and dampers to the plan, and gravity; notes what it was asked."""

    def __init__(self, plan: Solution) -> None:
        self.plan, self.data = plan, plan.model.createData()
        self.asked: list[tuple[float, np.ndarray]] = []

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        now = self.plan.sample(times=[min(t, float(self.plan.t[-1]))])
        self.asked.append((t, touching))
        pull = 400 * pin.difference(self.plan.model, q, now.q[0]) + 40 * (now.v[0] - v)
        return np.asarray(pull + pin.computeGeneralizedGravity(self.plan.model, self.data, q))


def test_a_controller_of_ones_own_is_asked_at_every_tick(reach: Solution) -> None:
    springs = Springs(reach)
    found = simulate(reach, controller=springs)
    assert found.report.joint_error_max < 0.05
    assert found.report.controller is None
    times = np.array([t for t, _ in springs.asked])
    np.testing.assert_allclose(times, np.arange(len(times)) * found.timeline.period)
    assert springs.asked[0][1].shape == (0,)
    assert found.as_solution().statistics.simulated


def test_a_tracker_is_the_whole_body_controller(reach: Solution) -> None:
    named = simulate(reach, controller="whole-body", control_rate=RATE)
    made = simulate(reach, controller=Tracker(reach, rate=RATE), control_rate=RATE)
    assert_array_equal(made.record.qpos, named.record.qpos)
    assert made.report.controller is not None
    assert made.report.controller.ticks == len(made.timeline.t)


def test_gains_are_those_of_the_whole_body_controller(reach: Solution) -> None:
    soft = TrackerGains(joint=5.0)
    given = simulate(reach, controller="whole-body", control_rate=RATE, gains=soft)
    made = simulate(reach, controller=Tracker(reach, rate=RATE, gains=soft), control_rate=RATE)
    usual = simulate(reach, controller="whole-body", control_rate=RATE)
    assert_array_equal(given.record.qpos, made.record.qpos)
    assert np.abs(given.record.qpos - usual.record.qpos).max() > 0


class Odd(Springs):
    """Returns what it was told to."""

    def __init__(self, plan: Solution, given: Any) -> None:
        super().__init__(plan)
        self.given = given

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        q[:], v[:] = np.nan, np.nan  # nothing of the simulation is changed by this
        if isinstance(self.given, Exception):
            raise self.given
        return self.given


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (np.zeros(3), r"torques of Odd at 0 s have shape \(3,\); allowed: \(6,\)"),
        (np.full(6, np.nan), "torques of Odd at 0 s are not finite"),
        (None, r"torques of Odd at 0 s"),
        (InputError("mine"), "^mine$"),
    ],
)
def test_what_are_no_torques_is_one_line(reach: Solution, given: Any, said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        simulate(reach, controller=Odd(reach, given), control_rate=RATE)
    assert "\n" not in str(refused.value)


def test_the_state_that_a_controller_gets_is_its_own(reach: Solution) -> None:
    assert np.isfinite(
        simulate(reach, controller=Odd(reach, np.zeros(6)), control_rate=RATE).record.qpos
    ).all()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"controller": "pid"}, "controller of SimulationSettings is 'pid'; .*joints, gains, whole-body"),
        ({"controller": 3}, "controller of SimulationSettings is 3; .*TorqueController"),
        ({"controller": Springs}, "controller of SimulationSettings is .*TorqueController"),
        ({"gains": TrackerGains()}, "gains of SimulationSettings .*'joints'; allowed: .*'whole-body'"),
        (
            {"gains": 8.0, "controller": "whole-body"},
            "gains of SimulationSettings is 8.0; .*TrackerGains",
        ),
    ],
)
def test_settings_of_controllers_are_checked(reach: Solution, settings: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        simulate(reach, **settings)
    assert "\n" not in str(refused.value)


def test_settings_of_other_controllers_are_refused(reach: Solution) -> None:
    with pytest.raises(InputError, match=r"kp of SimulationSettings is 2.*controller Springs"):
        simulate(reach, controller=Springs(reach), kp=2.0)


def test_a_tracker_of_other_ticks_or_another_plan_is_refused(reach: Solution) -> None:
    with pytest.raises(InputError, match=r"other ticks; allowed: .*rate=1000"):
        simulate(reach, controller=Tracker(reach, rate=RATE))
    other = trajopt.solve(trajopt.load("arm-reach", robot="z1"), fixed_mesh=True)
    with pytest.raises(InputError, match="of another plan"):
        simulate(reach, controller=Tracker(other, rate=RATE), control_rate=RATE)


def test_what_has_a_torque_is_a_controller(reach: Solution) -> None:
    assert isinstance(Springs(reach), TorqueController)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return np.zeros(6)", "not tracked"),
        ("return q[9]", "mine.py, line 6: IndexError"),
        ("pass\ndel build", "has no build(); def build(plan)"),
    ],
)
def test_the_command_asks_a_controller_from_a_file(reach: Solution, body: str, said: str, tmp_path: Path):
    plan, mine = reach.save(tmp_path / "reach.npz"), tmp_path / "mine.py"
    head = "import numpy as np\ndef build(plan):\n    return Still()\nclass Still:\n"
    mine.write_text(f"{head}    def torque(self, t, q, v, touching):\n        {body}")
    done = invoke("simulate", plan, "--controller", mine, "--control-rate", RATE)
    assert said in done.stdout if done.exit_code == 1 else assert_refused(done, said) is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("export", "--quaternion", "wxyz"), "allowed: for a robot whose base moves"),
        (("export", "--base-velocity", "body"), "--base-velocity has no effect on"),
        (("simulate", "--friction-scale", 0.5), "'ur5', which touches nothing; allowed: for motions with"),
        (("simulate", "--controller", "none.py"), "none.py does not exist"),
    ],
)
def test_options_without_effect_are_refused(reach: Solution, words: tuple, said: str, tmp_path: Path):
    assert_refused(invoke(words[0], reach.save(tmp_path / "reach.npz"), *words[1:]), said)

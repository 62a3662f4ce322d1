"""Schedules that are found without one: costs, certificates, known answers, refusals, records."""

import json
import time

import casadi as ca
import numpy as np
import pytest

import trajopt
from tests.support.refusals import refusals, refused
from tests.support.solved_problems import motion
from trajopt.robot import contact_positions
from trajopt.study.discovery import ContactTask, Destination, discover, relaxed_motion, search, task_to
from trajopt.study.discovery.goal import obstacle
from trajopt.study.discovery.proposals import known_proposals, nearest_gait
from trajopt.study.discovery.records import CERTIFIED, RECORD, SCREENED, UNTRIED
from trajopt.study.discovery.search import nearest_reached
from trajopt.study.discovery.task import gap, smooth_gap
from trajopt.terrain import FlatGround, PiecewiseTerrain, SmoothTerrain, Wave
from trajopt_library import problems, robots

pytestmark = pytest.mark.long

SLACK = 0.003  # the last one


@pytest.fixture(scope="module")
def hop():
    return discover(problems.load("hopper-hop"), seeds=2)


def test_a_hop_is_found_and_costs_no_more_than_the_librarys_own(hop):
    own = motion("hopper-hop")
    best = hop.best[0]
    assert best.objective <= 1.05 * own.statistics.objective
    assert not trajopt.check(best.solution).failures()
    assert sum(1 for contacts in best.modes.key if not contacts) == 1  # one flight


def test_every_candidate_is_told_with_the_reason(hop):
    sources = {each.source for each in hop.candidates}
    assert sources >= {"hop", "relaxed:0", "relaxed:1"}
    assert len(sources) == len(hop.candidates)
    for each in hop.candidates:
        assert (each.status == CERTIFIED) == (each.objective is not None) == (not each.why)
    json.dumps(hop.to_dict())


def test_a_way_beyond_one_hop_takes_several():
    problem = problems.load("hopper-hop", distance=0.6)
    assert not trajopt.solve(problem).success  # its own schedule has one
    best = discover(problem, seeds=2, known=False).best[0]
    assert sum(1 for contacts in best.modes.key if not contacts) > 1
    assert not trajopt.check(best.solution).failures()


def test_relaxed_contacts_push_near_the_ground_only():
    task = ContactTask.of(problems.load("hopper-hop"))
    solution = relaxed_motion(task).solution
    robot, rows = task.robot, solution.collocation
    heights = [contact_positions(robot, q)["foot"][2] - robot.contacts[0].radius for q in solution.q[rows]]
    products = solution.f[rows][:, 0, 2] / robot.weight * np.array(heights) / robot.length
    assert min(heights) > -1e-6
    assert np.max(products) < SLACK * (1 + 1e-4)


@pytest.fixture(scope="module")
def trot():
    return discover(problems.load("quadruped-trot", robot="solo12"), seeds=1, keep=2)


def test_a_trot_of_solo12_is_found_from_standing_legs(trot):
    own = motion("quadruped-trot", robot="solo12")
    relaxed = next(each for each in trot.candidates if each.source == "relaxed:0")
    assert relaxed.objective <= 1.05 * own.statistics.objective
    assert nearest_gait(trot.task, relaxed.modes) is not None


@pytest.mark.slow
def test_a_box_that_can_be_stepped_is_not_jumped():
    problem = problems.load("quadruped-box-up", robot="go2")
    found = discover(problem, seeds=2, known=False)
    own = trajopt.solve(problem)
    best = found.best[0]
    assert all(best.modes.key)  # no flight
    assert best.objective < own.statistics.objective
    assert not trajopt.check(best.solution).failures()
    assert found.task.left_out == ("frames_above",)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "robot"),
    [("biped-jump-forward", "talos"), ("quadruped-waves", "solo12"), ("quadruped-stepping-stones", "go2")],
)
def test_soles_curved_ground_and_stones(name, robot):
    found = discover(problems.load(name, robot=robot), seeds=2, known=False)
    assert not trajopt.check(found.best[0].solution).failures()


def test_half_a_mirrored_cycle_becomes_a_whole_one():
    problem = problems.load("biped-gait", robot="bolt")
    task = ContactTask.of(problem)
    assert task.duration == pytest.approx(2 * problem.schedule.duration)
    assert not task.problem.periodicity.mirror
    feet = [set(phase.contacts) for phase in task.problem.schedule.phases]
    half = len(feet) // 2
    assert [len(each) for each in feet[:half]] == [len(each) for each in feet[half:]]
    assert feet[:half] != feet[half:]


def test_a_goal_of_a_robot_is_reached():
    found = discover(task_to(robots.load("hopper"), Destination(x=0.15)), seeds=1)
    end = found.best[0].solution.q[-1]
    assert end[0] == pytest.approx(robots.load("hopper").reference[0] + 0.15, abs=1e-6)


def test_the_nearest_part_of_a_way_that_is_too_far():
    robot = robots.load("hopper")

    def make(part):
        return task_to(robot, Destination(x=3.0 * part, duration=1.2))

    assert not discover(make(1.0), seeds=1).best
    part, found = nearest_reached(make, halvings=2, seeds=1)
    assert 0 < part < 1
    assert found.best


def test_without_effort_only_the_first_proposals_are_tried(hop):
    found = discover(problems.load("hopper-hop"), seeds=3, effort=1e-3)
    assert found.best
    untried = [each for each in found.candidates if each.status == UNTRIED]
    assert {each.source for each in untried} >= {"relaxed:1", "relaxed:2"}
    assert all(each.seconds == 0 and each.why == "the effort was used" for each in untried)
    assert found.effort < hop.effort


def test_only_the_best_on_a_coarse_mesh_are_certified(trot):
    compared = [each for each in trot.candidates if each.status == SCREENED and each.screened is not None]
    assert compared
    assert len(trot.best) <= 3
    assert all(each.screened >= trot.best[0].screened * 0.98 for each in compared)
    gaits = [each.source for each in trot.candidates if each.source.startswith("gait:")]
    assert len(gaits) == len(set(gaits))


def test_a_neighbour_of_the_best_schedule_is_better():
    """Relaxed contacts of G1 have phases on both feet that cost more than they bring."""
    found = discover(problems.load("biped-gait", robot="g1"), seeds=1, known=False)
    relaxed = next(each for each in found.candidates if each.source == "relaxed:0")
    assert found.best[0].objective <= relaxed.objective
    assert found.best[0].source.startswith("relaxed:0")


def test_records_are_resumed(tmp_path):
    problem = problems.load("hopper-hop")
    first = discover(problem, seeds=1, folder=tmp_path)
    again = discover(problem, seeds=1, folder=tmp_path, resume=True, max_time=1e-3)
    assert again.to_dict() == first.to_dict()
    assert again.best[0].solution.statistics.objective == first.best[0].objective
    more = discover(problem, seeds=2, folder=tmp_path, resume=True)
    assert {each.source for each in more.candidates} - {each.source for each in first.candidates} >= {
        "relaxed:1"
    }
    for other in (problems.load("hopper-gait"), problems.load("hopper-hop", distance=0.21)):
        with refused("holds a discovery with another task"):
            discover(other, seeds=1, folder=tmp_path, resume=True)
    (tmp_path / RECORD).write_text("{")
    with refused("holds no discovery"):
        discover(problem, seeds=1, folder=tmp_path, resume=True)


@pytest.mark.parametrize("name", ["talos", "g1_arms"])
def test_a_humanoid_gets_to_a_goal_on_its_feet_and_its_hands_touch_nothing(name):
    task = task_to(robots.load(name), Destination(x=0.2))
    assert task.standing(task.problem.initial_q) == ("left", "right")
    assert [contact.name for contact in task.robot.contacts] == ["left", "right"]
    modes = next(each.modes for each in known_proposals(task) if each.source == "steps:walk:1")
    names = [step.contacts for step in task.with_modes(modes, task.still).schedule.phases]
    assert names == [*modes.key]


test_problems_without_a_schedule_to_find_are_refused = refusals(
    lambda name, values: discover(problems.load(name, **values)),
    ("ur5-reach", {}, "no feet on a moving base"),
    ("hopper-hop", {"coordinates": "minimal"}, "minimal coordinates"),
    ("talos-wall", {}, "phases say what 'hand' touches"),
)


@pytest.mark.parametrize(
    "settings", [{"seeds": 0, "known": False}, {"seeds": -1}, {"most": 0}, {"max_time": 0.0}]
)
def test_settings_with_which_nothing_is_tried_are_refused(settings):
    with refused("nothing is proposed"):
        discover(problems.load("hopper-hop"), **settings)


def test_a_scheduler_needs_no_number_of_processes():
    with refused("no scheduler answers at 'nowhere'"):
        discover(problems.load("hopper-hop"), scheduler="nowhere")


GROUNDS = {
    "level": FlatGround(height=0.1),
    "slope": FlatGround(normal=(0.2, -0.1, 1.0)),
    "waves": SmoothTerrain(shapes=(Wave(amplitude=0.02, wavelength=1.0),)),
    "box": PiecewiseTerrain.box(0.2, 1.0, 1.0, at=(1.0, 0.0)),
    "gap": PiecewiseTerrain.gap(0.4, at=(0.5, 0.0)),
}


@pytest.mark.parametrize("name", GROUNDS)
def test_smooth_heights_are_those_of_the_ground_away_from_edges(name):
    point = ca.SX.sym("p", 3)
    height = smooth_gap(GROUNDS[name], point, 0.02, 0.3, ca.DM)
    function = ca.Function("height", [point], [height])
    for place in ([0.2, 0.1, 0.3], [1.1, -0.2, 0.5], [-0.6, 0.3, 0.1]):
        expected = gap(GROUNDS[name], np.array(place), 0.02)
        assert float(function(place)) == pytest.approx(expected, abs=1e-5)


def test_a_hole_is_deep():
    ground, point = GROUNDS["gap"], ca.SX.sym("p", 3)
    height = ca.Function("height", [point], [smooth_gap(ground, point, 0.0, 0.3, ca.DM)])
    assert float(height([0.7, 0.0, 0.0])) == pytest.approx(0.15, abs=1e-3)
    assert np.isinf(gap(ground, np.array([0.7, 0.0, 0.0]), 0.0))


def test_goals_that_no_posture_reaches_are_refused():
    hopper, go2 = robots.load("hopper"), robots.load("go2")
    with refused("beside it"):
        task_to(hopper, Destination(y=0.1))
    high = Destination(x=0.1)  # front feet on the box, hind feet before it
    with refused("does not reach"):
        task_to(go2, high, obstacle(go2, "box", 1.0, high))
    with refused("no feet"):
        task_to(robots.load("ur5"), Destination())


def test_processes_find_the_same_schedules(hop):
    found = discover(problems.load("hopper-hop"), seeds=2, jobs=2)
    costs = {each.source: each.objective for each in found.candidates}
    assert costs == pytest.approx({each.source: each.objective for each in hop.candidates}, nan_ok=True)


def test_a_process_that_takes_too_long_is_a_reason(monkeypatch):
    monkeypatch.setattr(search, "relaxed_proposal", _sleep)
    monkeypatch.setattr(search, "TIME_FACTOR", 0.05)
    found = discover(problems.load("hopper-hop"), seeds=2, known=False, jobs=2, max_time=20.0)
    assert [each.source for each in found.candidates][:2] == ["relaxed:0", "relaxed:1"]
    assert all("1 s" in each.why for each in found.candidates)


def _sleep(*_):
    time.sleep(60)

"""Obstacles of a problem's `Clearance` in its solution: in the file, in the check, replayed, plotted."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.refusals import refused
from tests.support.replay_pages import objects_of, placements_of, shown
from tests.support.swings import BALL, FAR, MARGIN, POLE, ROD_CAPSULES, avoided, past, swing
from tests.support.synthetic_motions import with_meta
from trajopt.certify.check import check
from trajopt.collision.near import CollisionScene
from trajopt.collision.shapes import LinkShape
from trajopt.motion.solution import Solution
from trajopt.solving.extraction import described_bodies
from trajopt.solving.graded import solve as solve_graded
from trajopt.terms import Clearance
from trajopt.view.plotting.motion import PlottedMotion


def test_file_holds_obstacles_and_the_shapes_of_the_links(tmp_path):
    problem, solution = avoided()
    loaded = Solution.load(solution.save(tmp_path / "swing.npz"))
    (term,) = (term for term in problem.terms if isinstance(term, Clearance))
    assert loaded.meta["collision"] == {
        "capsules": [],
        "obstacles": [BALL.describe(), FAR.describe()],
        "self_pairs": [],
    }
    assert loaded.meta["bodies"]["shapes"] == [shape.describe() for shape in term.shapes]
    assert check(loaded).to_dict() == check(solution).to_dict()


def test_check_finds_a_motion_that_collides():
    _, solution = avoided()
    moved = {**solution.meta["collision"], "obstacles": [replace(BALL, radius=0.2).describe()]}
    report = check(with_meta(solution, collision=moved))
    assert report.failures() == ("obstacle_distance", "clearance_margin")
    assert report.obstacle_distance < -0.03


def test_check_finds_a_motion_that_keeps_less_than_the_margin_and_touches_nothing():
    _, solution = avoided()
    wider = {"obstacles": MARGIN + 0.01, "pairs": []}
    report = check(with_meta(solution, bodies={**solution.meta["bodies"], "margins": wider}))
    assert report.failures() == ("clearance_margin",)
    assert report.clearance_margin == pytest.approx(report.obstacle_distance - MARGIN - 0.01)
    assert report.places["clearance_margin"] == report.places["obstacle_distance"]
    assert 0 < report.obstacle_distance < MARGIN + 0.01


def test_file_without_margins_is_judged_by_contact_alone():
    _, solution = avoided()
    bodies = {key: value for key, value in solution.meta["bodies"].items() if key != "margins"}
    report = check(with_meta(solution, bodies=bodies))
    assert report.clearance_margin is None
    # The margin is one more figure whose worst is looked at: samples in between differ.
    assert report.obstacle_distance == pytest.approx(check(solution).obstacle_distance, abs=1e-6)
    problem = past(swing(), BALL, margin=0.0)
    assert described_bodies(problem)["margins"] is None


def test_motion_at_less_than_the_margin_is_no_success():
    """The links pass beside a ball at half the margin, and can do nothing about it in their plane."""
    thickness = max(shape.radius for shape in ROD_CAPSULES)
    beside = replace(POLE, centre=POLE.centre + np.array([0.0, thickness + POLE.radius + MARGIN / 2, 0.0]))
    draft = solve_graded(past(swing(), beside), draft=True)
    assert draft.converged
    assert not draft.success
    assert draft.statistics.status == "coarse_grid"
    assert "clearance_margin" in draft.statistics.failures
    assert "obstacle_distance" not in draft.statistics.failures
    assert "distance beyond the margin asked for" in draft.statistics.advice


def test_older_file_with_capsules_alone_is_measured_by_them():
    _, solution = avoided()
    capsules = solution.meta["bodies"]["shapes"]
    scene = {**solution.meta["collision"], "capsules": capsules}
    older = with_meta(solution, drop=("bodies",), collision=scene)
    assert check(older).obstacle_distance == pytest.approx(check(solution).obstacle_distance)


NOWHERE = LinkShape.sphere("c", "nose", np.zeros(3), 0.1)
WRONG = {
    "list": [],
    "capsules": {"capsules": None, "obstacles": [], "self_pairs": []},
    "obstacle": {"capsules": [], "obstacles": [{"kind": "cone"}], "self_pairs": []},
    "pair": {"capsules": [], "obstacles": [], "self_pairs": [["a"]]},
    "frame": {"capsules": [NOWHERE.describe()], "obstacles": [], "self_pairs": []},
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_description_in_a_file_is_refused_in_one_line(case):
    _, solution = avoided()
    with refused("collision of meta: "):
        check(with_meta(solution, collision=WRONG[case]))


MARGINS = {
    "list": [],
    "none of obstacles": {"pairs": []},
    "pairs": {"obstacles": 0.0, "pairs": [0.1]},
    "negative": {"obstacles": -0.1, "pairs": []},
    "word": {"obstacles": "wide", "pairs": []},
}


@pytest.mark.parametrize("case", MARGINS)
def test_wrong_margins_in_a_file_are_refused_in_one_line(case):
    _, solution = avoided()
    with refused("margins of bodies of meta"):
        check(with_meta(solution, bodies={**solution.meta["bodies"], "margins": MARGINS[case]}))


def test_replay_draws_obstacles_where_they_are(tmp_path):
    _, solution = avoided()
    page = shown(solution, tmp_path)
    drawn, places = objects_of(page), placements_of(page)
    found = {name.split("obstacles/")[1] for name in drawn if "obstacles/" in name}
    assert found == {"ball/start", "far/start", "far/end", "far/side"}
    (ball,) = (matrix for name, matrix in places.items() if name.endswith("ball/start"))
    assert ball[:3, 3] == pytest.approx(BALL.centre, abs=1e-6)


def test_plots_have_the_distance_from_each_obstacle_by_the_links_shapes():
    problem, solution = avoided()
    (term,) = (term for term in problem.terms if isinstance(term, Clearance))
    scene = CollisionScene(model=solution.model, shapes=term.shapes, obstacles=term.obstacles)
    least = scene.distances(solution.q)
    found = PlottedMotion(solution).clearances
    assert set(found) == {"ball", "far"}
    assert found["ball"] == pytest.approx(least[:, ::2].min(axis=1))
    assert found["far"] == pytest.approx(least[:, 1::2].min(axis=1))
    without = solution.with_description(obstacles=())
    assert PlottedMotion(without).clearances == {}
    assert without.description.capsule_scene(solution.model) is None

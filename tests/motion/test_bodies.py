"""The shapes of links in a solution's file: written, read, refused, measured by the check and drawn."""

import json

import numpy as np
import pytest

from tests.support.refusals import refused
from tests.support.replay_pages import objects_of, placements_of, shown
from tests.support.synthetic_motions import sampled, standing, with_meta
from trajopt.certify.check import check
from trajopt.collision.description import RobotShapes, robot_shapes
from trajopt.collision.shapes import SphereObstacle
from trajopt.motion.solution import Solution
from trajopt.problem.problem import rest
from trajopt.solving.solving import solve
from trajopt.terrain import FlatGround, PiecewiseTerrain
from trajopt.view.replay.motion import replay_motion
from trajopt.view.replay.scene import build_scene
from trajopt_library import robots

EXACT = 1e-8  # m; what Coal's iterations leave
ROBOT = robots.load("solo12")


def still(**meta: object) -> Solution:
    """Solo12 at rest in its reference, with its shapes."""
    given = {"bodies": robot_shapes(ROBOT).describe(), "terrain": FlatGround().describe()}
    return sampled(ROBOT, [standing(ROBOT, 0.2)], 3, **(given | meta))


def test_solution_of_a_problem_holds_the_robots_shapes(tmp_path):
    solution = solve(rest(ROBOT))
    loaded = Solution.load(solution.save(tmp_path / "rest.npz"))
    expected, found = robot_shapes(ROBOT), loaded.description.bodies
    assert found.describe() == expected.describe()
    assert json.loads(json.dumps(loaded.meta["bodies"])) == expected.describe()
    assert loaded.description.body_scene(loaded.model).pairs[0] == (expected.shapes[0].name, "ground")


def test_robot_without_shapes_has_none_in_its_solution():
    solution = solve(rest(robots.load("irb1600")))
    assert "bodies" not in solution.meta
    assert check(solution).link_depth is None


def test_figures_are_the_least_distances_of_the_scene():
    plan = still()
    scene = plan.description.body_scene(plan.model)
    distances = scene.distances(ROBOT.reference)[0]
    found = check(plan)
    assert found.link_depth == pytest.approx(-distances[: scene.n_ground].min(), abs=EXACT)
    assert found.self_distance == pytest.approx(distances[scene.n_ground :].min(), abs=EXACT)
    assert found.obstacle_distance is None


def test_ground_and_obstacles_of_the_file_are_measured():
    plan = still()
    raised = check(still(terrain=FlatGround(height=0.05).describe()))
    assert raised.link_depth == pytest.approx(check(plan).link_depth + 0.05, abs=EXACT)
    hole = PiecewiseTerrain.stepping_stones([(50.0, 50.0)], 0.2).describe()
    assert check(still(terrain=hole)).link_depth < -10
    ball = SphereObstacle(name="ball", centre=ROBOT.reference[:3] + np.array([0, 0, 0.4]), radius=0.1)
    scene = {"capsules": [], "obstacles": [ball.describe()], "self_pairs": []}
    assert 0.1 < check(still(collision=scene)).obstacle_distance < 0.4 - 0.1


def test_file_without_shapes_is_read_and_has_no_figures(tmp_path):
    plan = still()
    loaded = Solution.load(with_meta(plan, drop=("bodies",)).save(tmp_path / "old.npz"))
    report = check(loaded)
    assert (report.link_depth, report.self_distance, report.obstacle_distance) == (None, None, None)
    assert "shapes of links" in report.table()
    assert "shapes of links" not in check(plan).table()


SHAPE = {"name": "s", "frame": "base_link", "points": [[0, 0, 0]], "radius": 0.1}
EMPTY = {"shapes": [], "pairs": [], "left_out": [], "missing": []}
WRONG = {
    "list": [],
    "keys": {"shapes": []},
    "shape": {**EMPTY, "shapes": [{"name": "s"}]},
    "frame": {**EMPTY, "shapes": [{**SHAPE, "frame": "nose"}]},
    "points": {**EMPTY, "shapes": [{**SHAPE, "points": [[0, 0]]}]},
    "pair": {**EMPTY, "shapes": [SHAPE], "pairs": [["s", "t"]]},
    "three": {**EMPTY, "pairs": [["s"]]},
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_description_is_refused_in_one_line(case):
    with refused("bodies of meta: "):
        check(with_meta(still(), bodies=WRONG[case]))


def test_description_of_shapes_is_read_again():
    found = RobotShapes.from_description(robot_shapes(ROBOT).describe())
    assert found.describe() == robot_shapes(ROBOT).describe()


def test_replay_has_a_layer_of_shapes_that_is_hidden_at_first(tmp_path):
    plan = still()
    page, facts = shown(plan, tmp_path), build_scene([plan], [replay_motion(plan)]).facts
    (layer,) = (layer for layer in facts["layers"] if layer["name"] == "shapes")
    assert not layer["visible"]
    drawn = {name for name in objects_of(page) if "shapes/" in name}
    assert len(drawn) == len(robot_shapes(ROBOT).shapes)
    (foot,) = (matrix for name, matrix in placements_of(page).items() if name.endswith("/FL_FOOT"))
    assert foot == pytest.approx(np.eye(4))


def test_nearest_pair_of_each_kind_is_exact_however_far():
    plan = still(terrain=FlatGround(height=-0.5).describe())
    ball = SphereObstacle(name="ball", centre=[4.0, 0.0, 0.3], radius=0.1)
    scene = {"capsules": [], "obstacles": [ball.describe()], "self_pairs": []}
    plan = with_meta(plan, collision=scene)
    full = plan.description.body_scene(plan.model)
    distances = full.distances(ROBOT.reference)[0]
    report = check(plan)
    assert report.link_depth == pytest.approx(-distances[: full.n_ground].min(), abs=EXACT)
    outer, own = distances[full.n_ground : full.n_outer], distances[full.n_outer :]
    assert report.obstacle_distance == pytest.approx(outer.min(), abs=EXACT)
    assert report.self_distance == pytest.approx(own.min(), abs=EXACT)


def test_distances_are_exact_within_the_limit_of_each_pair():
    scene = robot_shapes(ROBOT).scene(ROBOT.model, FlatGround())
    exact = scene.distances(ROBOT.reference)[0]
    limits = np.where(np.arange(len(exact)) % 2, np.inf, 0.0)
    found = scene.distances(ROBOT.reference, limits)[0]
    assert found[1::2] == pytest.approx(exact[1::2], abs=EXACT)
    assert (found <= exact + EXACT).all()
    assert (found[exact > 0] > 0).all()

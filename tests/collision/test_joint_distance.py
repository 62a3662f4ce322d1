"""Distances of links that few joints lie between: fits beside Coal's, and whole solves of G1."""

import numpy as np
import pytest

import trajopt
from tests.support.problems import hop
from trajopt.collision.joint_distance import REACH, STEP, JointDistances
from trajopt.collision.near import CollisionScene
from trajopt.problem.bodies import bodies_of
from trajopt_library import robots

HIP = ("left_hip_roll_link", "pelvis_contour_link")
# Errors of a fit over its cell, m: hulls of meshes have edges.
ERROR = 1e-3


@pytest.fixture(scope="module")
def scene() -> CollisionScene:
    return bodies_of(trajopt.load("biped-jump-up", robot="g1")).scene


def test_a_row_is_the_distance_where_it_is_laid_and_near_it_around(scene: CollisionScene) -> None:
    fits, generator = JointDistances(scene), np.random.default_rng(0)
    model, column = scene.model, scene.pairs.index(HIP)
    rows = [model.joints[joint].idx_q for joint in fits.joints(HIP)]
    q = np.tile(robots.load("g1").reference, (20, 1))
    q[:, rows] = generator.uniform([-2.0, -0.3], [0.5, 0.5], size=(20, 2))
    parameters = fits.rows(HIP, q, 0.002)
    moved = q.copy()
    moved[:, rows] += generator.uniform(STEP / 2 - REACH, REACH - STEP / 2, size=(20, 2))
    for at, error in ((q, 1e-12), (moved, ERROR)):
        found = fits.values(HIP, at, parameters)
        np.testing.assert_allclose(found, scene.distances(at)[:, column] - 0.002, atol=error)


@pytest.mark.parametrize(
    ("pair", "joints"),
    [
        (HIP, ["left_hip_pitch_joint", "left_hip_roll_joint"]),
        (("left_hip_yaw_link", "right_hip_yaw_link"), []),
        (("left_hip_roll_link", "ground"), []),
    ],
)
def test_few_revolute_joints_lie_between_two_links(
    scene: CollisionScene, pair: tuple[str, str], joints: list[str]
) -> None:
    assert [scene.model.names[joint] for joint in JointDistances(scene).joints(pair)] == joints


def test_links_that_a_slide_moves_are_not_fitted() -> None:
    scene = bodies_of(hop()).scene
    fits = JointDistances(scene)
    for pair in scene.pairs:
        assert all(scene.model.joints[joint].shortname()[-1] in "XYZ" for joint in fits.joints(pair))


@pytest.mark.long
@pytest.mark.slow
def test_near_links_of_a_jump_take_few_iterations() -> None:
    solution = trajopt.solve(trajopt.load("biped-jump-up", robot="g1"))
    first, *others = solution.statistics.rounds
    assert solution.success
    assert trajopt.check(solution).ok
    assert sum(each.iterations for each in others) < 5 * first.iterations

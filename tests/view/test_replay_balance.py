"""Centre of mass, zero-moment point and support of a replay against numeric Pinocchio and closed forms."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.replay_pages import objects_of, on_surface, placements_of, shown, tracks_of
from tests.support.synthetic_motions import arm_motion, pushing_off, sampled, standing, with_meta
from trajopt.motion.samples import sample_quantities
from trajopt.motion.solution import Solution
from trajopt.robot.payload import Payload, loaded, loaded_model
from trajopt.terrain.surface import Surface
from trajopt.view.replay.balance import SUPPORT_LIFT, BalanceTrack, balance_of, on_ground, outer_wrenches
from trajopt.view.replay.motion import replay_motion
from trajopt.view.replay.scene import build_scene
from trajopt_library import robots

INTERVALS = 4
THINNED = 5e-4  # m: twice the stated error of a robot half a metre long, and rounding
EXACT = 1e-9  # m: rounding of positions around one
INTEGRATED = 1e-9  # over weight and metre: accelerations of the synthetic motion solve a linear system
INTERPOLATED = 1e-5  # m: feet of configurations that are interpolated between samples move a little
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def rising() -> Solution:
    """Solo12 with a heavy foot pushes itself up: forces and momentum of one motion by its equations."""
    robot = loaded(robots.load("solo12"), Payload(contact="FL_FOOT", mass=0.5))
    return sampled(robot, [pushing_off(robot)], INTERVALS)


def balance(solution: Solution) -> BalanceTrack:
    motion = replay_motion(solution)
    return balance_of(solution, motion)


def centre_of_pressure(solution: Solution) -> np.ndarray:
    """Of the contact forces in the plane z = 0, from their definition: (n, 2) at the frames."""
    motion = replay_motion(solution)
    place, force = motion.feet, motion.force
    turned = place[..., :2] * force[..., 2:] - place[..., 2:] * force[..., :2]
    return turned.sum(axis=1) / force[..., 2:].sum(axis=1)


def test_zero_moment_point_on_flat_ground_is_the_centre_of_pressure(rising):
    found, pressure = balance(rising), centre_of_pressure(rising)
    assert np.abs(pressure).max() > 1e-2  # not in the middle
    assert_allclose(found.zmp[:, :2], pressure, atol=INTERPOLATED)
    assert_allclose(found.zmp[:, 2], 0.0, atol=EXACT)


def test_momentum_changes_by_the_contact_forces(rising):
    force, moment = outer_wrenches(rising)
    samples = sample_quantities(rising)
    forces = rising.f[..., :3]
    weight = replay_motion(rising).weight
    turning = np.cross(samples.position, forces).sum(axis=1)
    assert_allclose(force, forces.sum(axis=1), atol=INTEGRATED * weight)
    assert_allclose(moment, turning, atol=INTEGRATED * weight)


def test_mark_of_the_zero_moment_point_is_drawn_there(rising, tmp_path):
    tracks = tracks_of(shown(rising, tmp_path))
    assert tracks["zmp/mark", "visible"].all()
    assert_allclose(tracks["zmp/mark", "position"][:, :2], centre_of_pressure(rising), atol=THINNED)


@pytest.mark.parametrize("name", ["talos", "bolt", "anymal_c"])
def test_zero_moment_point_of_a_robot_at_rest_is_below_its_centre_of_mass(name):
    robot = robots.load(name)
    resting = sampled(robot, [standing(robot)], 1)
    found = balance(resting)
    com = pin.centerOfMass(robot.model, robot.model.createData(), robot.reference)
    assert_allclose(found.com, np.tile(com, (len(found.com), 1)), atol=EXACT)
    assert_allclose(found.below[:, :2], found.com[:, :2], atol=EXACT)
    # the contact forces of such a stance are a least-squares solution: they balance if they can
    balanced = np.linalg.norm(
        replay_motion(resting).force.sum(axis=1)[0] + robot.mass * robot.model.gravity.linear
    )
    assert balanced < 1e-6 * robot.weight
    assert_allclose(found.zmp[:, :2], found.com[:, :2], atol=EXACT)


def test_zero_moment_point_is_hidden_in_flight(bones, tmp_path):
    tracks, motion = tracks_of(shown(bones, tmp_path)), replay_motion(bones)
    np.testing.assert_array_equal(tracks["zmp/mark", "visible"][:, 0], motion.active.any(axis=1))


def test_centre_of_mass_includes_what_is_carried(bones):
    body = {"frame": "FL_FOOT", "mass": 0.4, "centre": [0.1, 0.0, 0.05], "inertia": np.zeros((3, 3)).tolist()}
    loaded = with_meta(bones, payloads=[{**body, "phases": [1]}])
    motion, model = replay_motion(bones), bones.model
    heavy = loaded_model(model, "FL_FOOT", pin.Inertia(0.4, np.array(body["centre"]), np.zeros((3, 3))))
    for row, com in enumerate(balance(loaded).com):
        carrying = heavy if motion.phase[row] == 1 else model
        expected = pin.centerOfMass(carrying, carrying.createData(), motion.q[row])
        assert_allclose(com, expected, atol=EXACT)


def test_support_is_the_hull_of_the_feet_on_the_drawn_ground_while_they_stand(bones, tmp_path):
    scene, motion = shown(bones, tmp_path), replay_motion(bones)
    tracks, size = tracks_of(scene), build_scene([bones], [motion]).facts["size"]
    # both stances are the same: one mark, seen in both
    shown_at = tracks["support/stance0", "visible"][:, 0]
    np.testing.assert_array_equal(shown_at, motion.active.any(axis=1))
    assert ("support/stance2", "visible") not in tracks
    edge = corners_of(scene, "support/stance0/edge")
    assert_allclose(edge[0], edge[-1])
    ground = placements_of(scene)["ground/plane"]
    assert_allclose((edge - ground[:3, 3]) @ UP, (0.002 + SUPPORT_LIFT) * size, atol=1e-4)
    feet = motion.feet[0][:, :2]
    for foot in feet:
        assert np.linalg.norm(edge[:, :2] - foot, axis=1).min() < 1e-6


def corners_of(scene: dict, path: str) -> np.ndarray:
    mesh = scene["meshes"][objects_of(scene)[path]["geometries"][0]["shared"]]
    return np.frombuffer(mesh["attributes"]["position"]["array"].data, np.float32).reshape(-1, 3)


def test_support_of_a_sole_has_its_corners():
    robot = robots.load("talos")
    found = balance(sampled(robot, [standing(robot)], 1, contact_sizes=sizes_of(robot)))
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    corners = [
        data.oMf[robot.model.getFrameId(contact.frame)].act(
            np.array([x * contact.half_length, y * contact.half_width, 0.0])
        )
        for contact in robot.contacts
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    hull = found.supports[0].hull
    assert len(hull) >= 4
    # the outermost corner in any direction is a corner of the hull
    for angle in np.linspace(0, 2 * np.pi, 17):
        way = np.array([np.cos(angle), np.sin(angle), 0.0])
        assert (hull @ way).max() == pytest.approx(max(float(way @ corner) for corner in corners), abs=EXACT)


def sizes_of(robot) -> list:  # type: ignore[no-untyped-def]
    return [[contact.half_length, contact.half_width] for contact in robot.contacts]


def test_contacts_on_different_planes_have_a_level_virtual_plane_through_their_mean(bones):
    wall = Surface(point=np.zeros(3), normal=np.array([-0.6, 0.0, 0.8]))
    leaning = on_surface(bones, {"FL_FOOT": wall}, {}, {"FL_FOOT": wall})
    found = balance(leaning)
    plane, feet = found.supports[0].plane, replay_motion(leaning).feet[0]
    assert_allclose(plane.normal, UP)
    assert_allclose(plane.point, feet.mean(axis=0), atol=EXACT)
    assert_allclose(found.zmp[0, 2], feet[:, 2].mean(), atol=EXACT)


def test_wall_is_no_support_of_feet_on_the_ground(bones):
    wall = Surface(point=np.zeros(3), normal=np.array([-1.0, 0.0, 0.0]))
    leaning = balance(on_surface(bones, {"FL_FOOT": wall})).supports[0]
    feet = replay_motion(bones).feet[0]
    own = [name != "FL_FOOT" for name in bones.contact_frames]
    assert len(leaning.hull) == 3
    assert_allclose(sorted(leaning.hull[:, 0]), sorted(feet[own, 0]), atol=EXACT)
    assert_allclose(leaning.plane.point[2], 0.0, atol=EXACT)


def test_two_feet_support_along_a_segment_and_one_at_a_point(bones):
    for count in (2, 1):
        active = bones.active.copy()
        active[:, count:] = False
        found = balance(replace(bones, active=active))
        feet = replay_motion(bones).feet[0][:count]
        assert_allclose(np.sort(found.supports[0].hull, axis=0), np.sort(feet, axis=0), atol=EXACT)


def test_projection_of_the_centre_of_mass_lies_vertically_below_on_slopes(bones):
    places = np.array([[0.3, -0.2, 1.0], [-1.0, 0.5, 0.7]])
    slope = {"kind": "flat", "height": 0.5, "normal": [0.6, 0.0, 0.8], "friction": 0.7}
    below = on_ground(with_meta(bones, terrain=slope), places)
    assert_allclose(below[:, :2], places[:, :2], atol=EXACT)
    assert_allclose(0.6 * below[:, 0] + 0.8 * (below[:, 2] - 0.5), 0.0, atol=EXACT)


def test_plumb_line_reaches_from_the_drawn_ground_to_the_centre_of_mass(rising, tmp_path):
    scene = shown(with_meta(rising, visual=None), tmp_path)
    tracks = tracks_of(scene)
    ground = placements_of(scene)["ground/plane"][2, 3]
    foot, length = tracks["com/plumb", "position"], tracks["com/plumb/upright/length", "scale"][:, 2]
    assert_allclose(foot[:, 2], ground, atol=2e-3)  # of the grid, which lies above the plane
    top = foot + length[:, None] * UP
    data = rising.model.createData()
    com = [pin.centerOfMass(rising.model, data, q) for q in replay_motion(rising).q]
    assert_allclose(top, com, atol=2 * THINNED)
    assert_allclose(tracks["com/ball", "position"], com, atol=THINNED)


def test_robot_that_is_bolted_down_has_no_zero_moment_point(tmp_path):
    robot = robots.load("ur5")
    paths = objects_of(shown(sampled(robot, [arm_motion(robot)], 2), tmp_path))
    assert not any(path.startswith(("zmp/", "support/")) for path in paths)
    assert any(path.startswith("com/") for path in paths)

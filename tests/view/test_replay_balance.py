"""Centre of mass, zero-moment point, support, arrows and friction cones of a replay against Pinocchio."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.models import placement
from tests.support.replay_pages import FLIGHT, STANCE, objects_of, on_surface, placements_of, shown, tracks_of
from tests.support.synthetic_motions import arm_motion, pushing_off, sampled, standing, with_meta
from trajopt import Contact, Robot, Solution
from trajopt.motion.samples import sample_quantities
from trajopt.robot import Payload, robot_file
from trajopt.robot.data import data_share
from trajopt.robot.payload import loaded, loaded_model
from trajopt.terrain import Surface
from trajopt.view.replay.balance import SUPPORT_LIFT, BalanceTrack, balance_of, on_ground, outer_wrenches
from trajopt.view.replay.contacts import COLOURS, SIDE
from trajopt.view.replay.motion import FLASH, replay_motion
from trajopt.view.replay.parts import colour_array
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


ARROW_INTERVALS, FOOT = 3, "FL_FOOT"
ROUNDING = 1e-12
SINGLE_PRECISION = 2e-6  # of lengths around one
TALOS = "talos_data/robots/talos_reduced.urdf"


@pytest.mark.parametrize("held", [False, True])
def test_force_of_a_sole_starts_at_its_centre_of_pressure_unless_it_is_held(held):
    frame, offset = "left_sole_link", np.array([0.03, -0.02, 0.0])
    sole = Contact(frame=frame, kind="surface", half_length=0.1, half_width=0.06)
    robot = Robot.from_urdf(robot_file(TALOS), contacts=[sole], package_dirs=[data_share()])
    turn = pin.utils.rotate("y", 0.7)
    q = robot.reference.copy()
    q[3:7] = pin.Quaternion(turn).coeffs()
    place = placement(robot.model, q, frame)
    force = place.rotation @ np.array([30.0, -10.0, 800.0])
    wrench = np.concatenate([force, np.cross(place.rotation @ offset, force)])
    base = standing(robot, STANCE)
    stance = replace(base, q=lambda t: q, f=lambda t: wrench[None])
    board = Surface(point=place.translation, normal=place.rotation[:, 2], bilateral=held)
    motion = replay_motion(on_surface(sampled(robot, [stance], ARROW_INTERVALS), {frame: board}))
    start = place.translation if held else place.act(offset)
    assert_allclose(motion.pressed(motion.wrench)[:, 0], np.tile(start, (motion.n_frames, 1)), atol=1e-9)


@pytest.fixture(scope="module")
def struck(bones) -> Solution:
    """The hop, landing on two feet by an impact of 2 and 1 N s."""
    impulse = np.zeros((1, 4, 6))
    impulse[0, 0, :3], impulse[0, 1, :3] = [0.0, 1.2, 1.6], [0.0, 0.0, 1.0]
    return replace(bones, impulse=impulse, impact_index=np.flatnonzero(bones.phase == 2)[:1])


@pytest.mark.parametrize("speed", [1.0, 0.2, 20.0])
def test_impulse_flashes_after_its_impact(struck, tmp_path, speed):
    tracks = tracks_of(shown(struck, tmp_path, speed=speed))
    motion = replay_motion(struck, speed)
    impact, frame = STANCE + FLIGHT, motion.t[1] - motion.t[0]
    for foot in struck.contact_frames[:2]:
        times = motion.t[tracks[f"impulses/{foot}", "visible"][:, 0].astype(bool)]
        assert -ROUNDING <= times[0] - impact < frame + ROUNDING
        assert times[-1] <= max(impact + FLASH, times[0])
        assert len(times) == max(1, np.sum((motion.t >= times[0]) & (motion.t < impact + FLASH)))
    assert not any(foot in path for path, _ in tracks if "impulses" in path for foot in ("HL_", "HR_"))


def test_impulses_and_forces_are_drawn_to_the_scales_in_the_caption(struck, tmp_path):
    tracks, motion = tracks_of(shown(struck, tmp_path)), replay_motion(struck)
    text = (tmp_path / "page.html").read_text()
    weight_arrow = float(re.search(r"forces: ([0-9.]+) m is the weight", text).group(1))
    assert f"impulses: {weight_arrow:.2f} m is {motion.weight * FLASH:.2f} N s" in text
    given = {f"impulses/{foot}": norm for foot, norm in zip(struck.contact_frames, (2.0, 1.0), strict=False)}
    given[f"forces/{FOOT}"] = np.linalg.norm(motion.force[0, 0]) * FLASH
    rows, necks = [], []
    for place, impulse in given.items():
        row = np.flatnonzero(tracks[place, "visible"][:, 0])[0]
        rows.append([tracks[f"{place}/head", "scale"][row, 0], -impulse])
        necks.append(tracks[f"{place}/head", "position"][row, 2])
    # neck + scale * head = impulse * constant, for one head length: three arrows, two unknowns
    (_, constant), residual, *_ = np.linalg.lstsq(np.array(rows), -np.array(necks), rcond=None)
    assert residual < SINGLE_PRECISION**2
    assert constant * motion.weight * FLASH == pytest.approx(weight_arrow, abs=0.005)  # two decimals


def test_replay_without_impacts_shows_no_impulses(bones, tmp_path):
    scene = shown(bones, tmp_path)
    assert not any(path.startswith("impulses/") for path in objects_of(scene))
    assert "N s" not in (tmp_path / "page.html").read_text()


CONE_FOOT, FRICTION = "FL_FOOT", 0.7
TURNED = 1e-3  # of axes: the stated error of angles, and rounding
TINTED = 4e-3  # of colours: the stated error, and rounding


def axes_of(quaternions: np.ndarray) -> np.ndarray:
    """Third columns (n, 3) of the rotations."""
    return np.array([pin.Quaternion(row).toRotationMatrix()[:, 2] for row in quaternions])


def pushed(solution: Solution, force: np.ndarray) -> Solution:
    """The same motion with another force (3,) wherever a contact is active."""
    f = solution.f.copy()
    f[..., :3] = np.where(solution.active[..., None], force, 0.0)
    return replace(solution, f=f)


def test_cone_stands_where_the_force_acts_as_wide_as_friction_and_hides_in_flight(bones, tmp_path):
    tracks, motion = tracks_of(shown(bones, tmp_path)), replay_motion(bones)
    size = build_scene([bones], [motion]).facts["size"]
    for contact, frame in enumerate(bones.contact_frames):
        visible = tracks[f"cones/{frame}", "visible"][:, 0]
        np.testing.assert_array_equal(visible, motion.active[:, contact])
        assert not visible.all()
        place = tracks[f"cones/{frame}", "position"][visible]
        assert_allclose(place, motion.feet[visible, contact], atol=THINNED)
        scale = tracks[f"cones/{frame}", "scale"][visible]
        assert_allclose(scale[:, :2] / scale[:, 2:], FRICTION, atol=TURNED)
        assert_allclose(np.hypot(scale[:, 0], scale[:, 2]), SIDE * size, rtol=THINNED / (SIDE * size))


def test_cone_of_a_phase_has_that_surfaces_friction_and_normal(bones, tmp_path):
    wall = Surface(point=np.zeros(3), normal=np.array([-0.6, 0.0, 0.8]), friction=0.3)
    tracks = tracks_of(shown(on_surface(bones, {CONE_FOOT: wall}, {}, {}), tmp_path))
    first = replay_motion(bones).phase == 0
    scale, axes = (
        tracks[f"cones/{CONE_FOOT}", "scale"],
        axes_of(tracks[f"cones/{CONE_FOOT}", "quaternion"]),
    )
    assert_allclose(scale[first, 0] / scale[first, 2], 0.3, atol=TURNED)
    assert_allclose(axes[first], np.tile(wall.normal, (first.sum(), 1)), atol=TURNED)
    last = replay_motion(bones).phase == 2
    assert_allclose(scale[last, 0] / scale[last, 2], FRICTION, atol=TURNED)
    assert_allclose(axes[last], np.tile([0.0, 0.0, 1.0], (last.sum(), 1)), atol=TURNED)


@pytest.mark.long
@pytest.mark.parametrize(
    ("used", "colour"), [(0.0, COLOURS[0]), (0.5, COLOURS[0]), (0.85, COLOURS[2]), (1.0, COLOURS[3])]
)
def test_colour_of_a_cone_says_how_near_the_force_is_to_its_edge(bones, tmp_path, used, colour):
    force = 20.0 * np.array([0.6 * used * FRICTION, -0.8 * used * FRICTION, 1.0])
    tracks = tracks_of(shown(pushed(bones, force), tmp_path))
    visible = tracks[f"cones/{CONE_FOOT}", "visible"][:, 0]
    for part in ("side", "rim"):
        colours = tracks[f"cones/{CONE_FOOT}/{part}/<object>", "material.color"][visible]
        assert_allclose(colours, np.tile(colour_array(colour), (visible.sum(), 1)), atol=TINTED)


def test_force_beyond_the_cone_and_one_that_pulls_are_alarming(bones, tmp_path):
    alarm = colour_array(COLOURS[-1])
    for force in ([30.0, 0.0, 20.0], [0.0, 0.0, -5.0]):
        tracks = tracks_of(shown(pushed(bones, np.array(force)), tmp_path))
        assert_allclose(tracks[f"cones/{CONE_FOOT}/side/<object>", "material.color"][0], alarm, atol=TINTED)


def test_held_contact_has_no_cone(bones, tmp_path):
    handle = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), bilateral=True)
    described = [{CONE_FOOT: handle}, {}, {CONE_FOOT: handle}]
    objects = objects_of(shown(on_surface(bones, *described), tmp_path))
    assert not any(path.startswith(f"cones/{CONE_FOOT}") for path in objects)
    assert any(path.startswith("cones/FR_FOOT") for path in objects)


def test_cone_of_a_sole_stands_on_its_centre_of_pressure(tmp_path):
    frame, offset = "left_sole_link", np.array([0.03, -0.02, 0.0])
    sole = Contact(frame=frame, kind="surface", half_length=0.1, half_width=0.06)
    robot = Robot.from_urdf(robot_file(TALOS), contacts=[sole], package_dirs=[data_share()])
    place = placement(robot.model, robot.reference, frame)
    force = np.array([30.0, -10.0, 800.0])
    wrench = np.concatenate([force, np.cross(place.rotation @ offset, force)])
    stance = replace(standing(robot, STANCE), f=lambda t: wrench[None])
    tracks = tracks_of(shown(sampled(robot, [stance], 3, visual=None), tmp_path))
    expected = place.act(offset)
    got = tracks[f"cones/{frame}", "position"]
    assert_allclose(got, np.tile(expected, (len(got), 1)), atol=THINNED)

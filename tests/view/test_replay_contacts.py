"""Friction cones of a replay: places, friction and normals of the contacts, and colours of their use."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.replay_pages import STANCE, objects_of, on_surface, shown, tracks_of
from tests.support.synthetic_motions import sampled, standing
from trajopt.motion.solution import Solution
from trajopt.robot.contact import Contact
from trajopt.robot.data import data_share, robot_file
from trajopt.robot.robot import Robot
from trajopt.terrain.surface import Surface
from trajopt.view.replay.contacts import COLOURS, SIDE
from trajopt.view.replay.motion import replay_motion
from trajopt.view.replay.parts import colour_array
from trajopt.view.replay.scene import build_scene

FOOT, FRICTION = "FL_FOOT", 0.7
TALOS = "talos_data/robots/talos_reduced.urdf"
THINNED = 5e-4  # m: twice the stated error of a robot half a metre long, and rounding
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
    tracks = tracks_of(shown(on_surface(bones, {FOOT: wall}, {}, {}), tmp_path))
    first = replay_motion(bones).phase == 0
    scale, axes = tracks[f"cones/{FOOT}", "scale"], axes_of(tracks[f"cones/{FOOT}", "quaternion"])
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
    visible = tracks[f"cones/{FOOT}", "visible"][:, 0]
    for part in ("side", "rim"):
        colours = tracks[f"cones/{FOOT}/{part}/<object>", "material.color"][visible]
        assert_allclose(colours, np.tile(colour_array(colour), (visible.sum(), 1)), atol=TINTED)


def test_force_beyond_the_cone_and_one_that_pulls_are_alarming(bones, tmp_path):
    alarm = colour_array(COLOURS[-1])
    for force in ([30.0, 0.0, 20.0], [0.0, 0.0, -5.0]):
        tracks = tracks_of(shown(pushed(bones, np.array(force)), tmp_path))
        assert_allclose(tracks[f"cones/{FOOT}/side/<object>", "material.color"][0], alarm, atol=TINTED)


def test_held_contact_has_no_cone(bones, tmp_path):
    handle = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), bilateral=True)
    described = [{FOOT: handle}, {}, {FOOT: handle}]
    objects = objects_of(shown(on_surface(bones, *described), tmp_path))
    assert not any(path.startswith(f"cones/{FOOT}") for path in objects)
    assert any(path.startswith("cones/FR_FOOT") for path in objects)


def test_cone_of_a_sole_stands_on_its_centre_of_pressure(tmp_path):
    frame, offset = "left_sole_link", np.array([0.03, -0.02, 0.0])
    sole = Contact(frame=frame, kind="surface", half_length=0.1, half_width=0.06)
    robot = Robot.from_urdf(robot_file(TALOS), contacts=[sole], package_dirs=[data_share()])
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    place = data.oMf[robot.model.getFrameId(frame)]
    force = np.array([30.0, -10.0, 800.0])
    wrench = np.concatenate([force, np.cross(place.rotation @ offset, force)])
    stance = replace(standing(robot, STANCE), f=lambda t: wrench[None])
    tracks = tracks_of(shown(sampled(robot, [stance], 3, visual=None), tmp_path))
    expected = place.act(offset)
    got = tracks[f"cones/{frame}", "position"]
    assert_allclose(got, np.tile(expected, (len(got), 1)), atol=THINNED)

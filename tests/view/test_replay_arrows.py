"""Arrows of a replay: where forces start, and the flash of an impulse."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.replay_pages import FLIGHT, STANCE, objects_of, on_surface, shown, tracks_of
from tests.support.synthetic_motions import sampled, standing
from trajopt.motion.solution import Solution
from trajopt.robot.contact import Contact
from trajopt.robot.data import data_share, robot_file
from trajopt.robot.robot import Robot
from trajopt.terrain.surface import Surface
from trajopt.view.replay.motion import FLASH, replay_motion

INTERVALS, FOOT = 3, "FL_FOOT"
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
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    place = data.oMf[robot.model.getFrameId(frame)]
    force = place.rotation @ np.array([30.0, -10.0, 800.0])
    wrench = np.concatenate([force, np.cross(place.rotation @ offset, force)])
    base = standing(robot, STANCE)
    stance = replace(base, q=lambda t: q, f=lambda t: wrench[None])
    board = Surface(point=place.translation, normal=place.rotation[:, 2], bilateral=held)
    motion = replay_motion(on_surface(sampled(robot, [stance], INTERVALS), {frame: board}))
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

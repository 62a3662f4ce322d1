"""Tracks keep what the viewer's interpolation needs to stay within the stated errors, and little else."""

import meshcat
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation, Slerp

from tests.support.replay_pages import hopping, key_frames_of, shown
from trajopt.view.replay.commands import (
    ANGLE_ERROR,
    FINER,
    POSITION_ERROR,
    Animation,
    Recorder,
    hold_while_hidden,
    quaternions,
    rounded,
    thin_key_frames,
    turns_to,
)

ERROR = 1e-3
ROUNDING = 1e-9


def smooth(n: int, columns: int) -> np.ndarray:
    t = np.linspace(0, 1, n)
    return np.column_stack([np.sin((3 + 2 * k) * t + k) for k in range(columns)])


@pytest.mark.parametrize("n", [2, 3, 17, 100, 1000])
def test_linear_track_stays_within_its_error_with_fewer_frames(n):
    values = smooth(n, 3)
    kept = thin_key_frames(values, "vector3", ERROR)
    between = np.column_stack([np.interp(np.arange(n), kept, column[kept]) for column in values.T])
    assert np.linalg.norm(between - values, axis=1).max() <= ERROR + ROUNDING
    assert kept[0] == 0
    assert kept[-1] == n - 1
    if n == 1000:
        assert len(kept) < 0.2 * n


def test_turning_track_stays_within_its_angle():
    vectors = smooth(400, 3)
    values = Rotation.from_rotvec(vectors).as_quat()
    values[::3] *= -1  # the same rotations
    kept = thin_key_frames(values, "quaternion", ANGLE_ERROR)
    between = Slerp(kept, Rotation.from_quat(values[kept]))(np.arange(400))
    error = (between.inv() * Rotation.from_rotvec(vectors)).magnitude()
    assert error.max() <= ANGLE_ERROR + ROUNDING
    assert len(kept) < 0.5 * 400


def test_tracks_as_written_stay_within_their_stated_errors():
    rotation = Rotation.from_rotvec(smooth(400, 3))
    tracks, node = Animation(400, 60.0, 1.0), meshcat.Visualizer(window=Recorder())["robot"]
    tracks.add(node, "position", smooth(400, 3))
    tracks.add(node, "quaternion", rotation.as_quat())
    position, turn = tracks.command().message["animations"][0]["clip"]["tracks"]
    times, values = (np.frombuffer(position[name].data, np.float32) for name in ("times", "values"))
    written = np.column_stack([np.interp(np.arange(400), times, row) for row in values.reshape(-1, 3).T])
    assert np.linalg.norm(written - smooth(400, 3), axis=1).max() <= POSITION_ERROR
    times, values = (np.frombuffer(turn[name].data, np.float32) for name in ("times", "values"))
    error = Slerp(times, Rotation.from_quat(values.reshape(-1, 4)))(np.arange(400)).inv() * rotation
    assert error.magnitude().max() <= ANGLE_ERROR


def test_still_track_keeps_its_ends_and_a_jump_both_its_sides():
    still = np.ones((50, 3))
    assert_array_equal(thin_key_frames(still, "vector3", ERROR), [0, 49])
    still[20:] += 1.0
    kept = thin_key_frames(still, "vector3", ERROR)
    assert {0, 19, 20, 49} <= set(kept.tolist())


def test_boolean_track_keeps_its_changes():
    shown_at = np.array([[True]] * 5 + [[False]] * 3 + [[True]] * 4)
    assert_array_equal(thin_key_frames(shown_at, "boolean", 0.0), [0, 5, 8, 11])


def test_rounding_is_far_below_the_error_and_to_few_bits():
    values = smooth(100, 3)
    near = rounded(values, ERROR)
    assert np.abs(near - values).max() <= ERROR / FINER / 2
    step = 2.0 ** np.floor(np.log2(ERROR / FINER))
    assert_array_equal(near / step, np.round(near / step))


def test_hidden_frames_hold_what_was_last_seen():
    values = np.arange(6.0)[:, None]
    seen = np.array([False, True, True, False, False, True])
    assert_array_equal(hold_while_hidden(values, seen)[:, 0], [1, 1, 2, 2, 2, 5])
    assert_array_equal(hold_while_hidden(values, np.zeros(6, dtype=bool))[:, 0], np.zeros(6))


def test_turns_take_the_vertical_to_any_direction():
    ways = np.array([[0, 0, 2.0], [0, 0, -3.0], [1.0, 2.0, -0.5], [1e-9, 0, -1.0], [0.0, 0.0, 0.0]])
    axes = Rotation.from_quat(turns_to(ways)).apply([0.0, 0.0, 1.0])
    expected = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-300)
    expected[4] = [0.0, 0.0, 1.0]
    np.testing.assert_allclose(axes, expected, atol=1e-8)


def test_standing_robot_needs_two_key_frames_a_track(tmp_path):
    frames = key_frames_of(shown(hopping(), tmp_path))
    assert max(count for (path, _), count in frames.items() if path.startswith("robot/")) == 2


def test_quaternions_of_matrices_are_scipys():
    turned = Rotation.random(100, random_state=0).as_matrix()
    half = Rotation.from_rotvec(np.pi * np.eye(3)).as_matrix()
    for rotations in (turned, half):
        assert_allclose(quaternions(rotations), Rotation.from_matrix(rotations).as_quat(), atol=ROUNDING)

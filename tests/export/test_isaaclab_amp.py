"""Isaac Lab's motions, read as its MotionLoader does: names, order of quaternions, frames of velocities."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.exported_plans import KINDS, SINGLE, moved_on, place_of, plan_to_export, rotation_of
from trajopt.export.exported_motion import sample_cycles
from trajopt.export.writing import export_motion

pytestmark = pytest.mark.long

RATE = 50


class LoadedMotion:
    """What the loader keeps: names, arrays, the time between frames; and what it does not read."""

    def __init__(self, path: Path) -> None:
        with np.load(path) as data:
            self.dof_names, self.body_names = data["dof_names"].tolist(), data["body_names"].tolist()
            self.dt = 1.0 / data["fps"]
            keys = [f"dof_{kind}" for kind in ("positions", "velocities", "torques")]
            keys += [f"body_{kind}" for kind in ("positions", "rotations")]
            keys += [f"body_{kind}_velocities" for kind in ("linear", "angular")]
            self.arrays = {key: data[key] for key in (*keys, "contact_forces", "contact_active")}
            self.types = {key: data[key].dtype for key in keys}
            self.fps = data["fps"]


@pytest.mark.parametrize("kind", KINDS)
def test_file_has_the_keys_shapes_and_types_that_the_loader_reads(kind: str, tmp_path: Path) -> None:
    read = LoadedMotion(export_motion(plan_to_export(kind), "isaaclab-amp", tmp_path / "a.npz", RATE))
    frames = len(read.arrays["dof_positions"])
    links, dofs = len(read.body_names), len(read.dof_names)
    assert {str(kind) for kind in read.types.values()} == {"float32"}
    assert (read.fps.shape, read.fps.dtype.kind, int(read.fps)) == ((), "i", RATE)
    assert read.arrays["dof_velocities"].shape == (frames, dofs)
    assert read.arrays["body_rotations"].shape == (frames, links, 4)
    assert read.arrays["body_angular_velocities"].shape == (frames, links, 3)
    assert len(set(read.body_names)) == links
    assert all(isinstance(name, str) for name in (*read.dof_names, *read.body_names))


@pytest.mark.parametrize("kind", KINDS)
def test_every_frame_is_the_plan_by_numeric_pinocchio(kind: str, tmp_path: Path) -> None:
    plan, model = plan_to_export(kind), plan_to_export(kind).model
    read = LoadedMotion(export_motion(plan, "isaaclab-amp", tmp_path / "a.npz", RATE))
    for row in range(0, int(plan.t[-1] * RATE), 5):
        own = plan.sample(times=[row * read.dt])
        for column, name in enumerate(read.dof_names):
            position = own.q[0, own.position_names.index(name)]
            assert_allclose(read.arrays["dof_positions"][row, column], position, atol=SINGLE)
            rate = own.v[0, own.velocity_names.index(name)]
            assert_allclose(read.arrays["dof_velocities"][row, column], rate, rtol=SINGLE, atol=SINGLE)
            torque = own.drive_torque[0, own.torque_names.index(name)]
            assert_allclose(read.arrays["dof_torques"][row, column], torque, rtol=SINGLE, atol=SINGLE)
        for column, name in enumerate(read.body_names):
            place = place_of(model, name, own.q[0], own.v[0])
            arrays = {key: read.arrays[key][row, column] for key in read.arrays if key.startswith("body")}
            assert_allclose(arrays["body_positions"], place.pose.translation, atol=SINGLE)
            assert_allclose(rotation_of(arrays["body_rotations"]), place.pose.rotation, atol=SINGLE)
            assert_allclose(arrays["body_linear_velocities"], place.linear, atol=5 * SINGLE)
            assert_allclose(arrays["body_angular_velocities"], place.angular, rtol=SINGLE, atol=5 * SINGLE)
        assert_allclose(read.arrays["contact_forces"][row], own.force[0], rtol=SINGLE, atol=1e-4)
        assert_array_equal(read.arrays["contact_active"][row], own.active[0])


def test_cycles_follow_each_other(tmp_path: Path) -> None:
    plan, duration = plan_to_export("turning trot"), plan_to_export("turning trot").t[-1]
    path = export_motion(plan, "isaaclab-amp", tmp_path / "a.npz", 10 / duration, 3)
    positions = LoadedMotion(path).arrays["body_positions"][:, 0]
    assert len(positions) == 31
    for passed in (1, 2):
        expected = [moved_on(plan, passed).act(np.float64(row)) for row in positions[:10]]
        assert_allclose(positions[10 * passed : 10 * passed + 10], expected, atol=SINGLE)


def test_a_rate_that_is_no_whole_number_is_kept(tmp_path: Path) -> None:
    path = export_motion(plan_to_export("an arm"), "isaaclab-amp", tmp_path / "a.npz", 62.5)
    assert LoadedMotion(path).dt == 1 / 62.5
    assert len(sample_cycles(plan_to_export("an arm"), 62.5).t) == len(
        LoadedMotion(path).arrays["dof_positions"]
    )

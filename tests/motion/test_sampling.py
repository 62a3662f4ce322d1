"""Samples of a motion at any times, as a table and as files."""

import csv
import math
import sys
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.refusals import assert_refused_in_one_line
from tests.support.sampled_problems import KINDS, solution_of_kind
from trajopt.certify.accuracy.between import figures_between_points
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.errors import InputError
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.sampled_motion import SampledMotion
from trajopt.motion.solution import Solution
from trajopt.robot.natural_units import NaturalUnits

# Solvers meet their rows, and with them the motion its own samples, to 1e-6 in scaled units.
SOLVED = 1e-4
# Of polynomials evaluated twice in two forms.
ROUNDING = 1e-9
# The dynamics are looked at in other places than the check's eleven of each interval.
LOOKED_ELSEWHERE = 1.3
# Of second-order quadrature with steps of 0.1 ms: the third derivative is below 1e4 / s^3.
QUADRATURE = 1e-4


@pytest.fixture(scope="module", params=[pytest.param(kind, marks=pytest.mark.long) for kind in KINDS])
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def solution(kind: str) -> Solution:
    return solution_of_kind(kind)


@pytest.fixture(scope="module")
def hop() -> Solution:
    return solution_of_kind("points")


def apart(solution: Solution, one: np.ndarray, other: np.ndarray) -> float:
    """The largest difference of configurations (n, nq) on the manifold."""
    return max(np.abs(pin.difference(solution.model, *rows)).max() for rows in zip(one, other, strict=True))


def equation_of_motion(solution: Solution, motion: SampledMotion) -> np.ndarray:
    """By how much samples miss the equation of motion by numeric Pinocchio (n, nv)."""
    frames, found = [solution.model.getFrameId(name) for name in motion.contact_frames], []
    models = [solution.carrying_model(phase) for phase in range(len(solution.phases))]
    for k, phase in enumerate(motion.phase):
        state = (motion.q[k], motion.v[k], motion.a[k])
        missed = generalized_force(models[phase], models[phase].createData(), state, frames, motion.f[k])
        missed[solution.n_unactuated :] -= motion.tau[k]
        found.append(missed)
    return np.array(found)


def test_samples_at_nodes_are_the_limits_on_their_side(solution: Solution) -> None:
    for side, edge, rows in (
        ("after", 0, [rows.start for rows in solution.intervals]),
        ("before", 1, [rows.stop - 1 for rows in solution.intervals]),
    ):
        motion = solution.sample(times=solution.interval_t[:, edge], side=side)
        assert apart(solution, motion.q, solution.q[rows]) < ROUNDING
        assert_allclose(motion.v, solution.v[rows], atol=SOLVED)
        assert_allclose(motion.tau, solution.tau[rows], atol=SOLVED)
        assert_allclose(motion.f, solution.f[rows], atol=SOLVED)
        assert_array_equal(motion.active, solution.active[rows])
        assert_array_equal(motion.phase, solution.phase[rows])


def test_samples_at_collocation_points_are_the_solutions(kind: str, solution: Solution) -> None:
    rows = np.flatnonzero(solution.collocation)
    inner = rows[~np.isin(solution.t[rows], solution.interval_t)]  # the others are nodes, with two limits
    motion = solution.sample(times=solution.t[inner])
    assert_allclose(motion.tau, solution.tau[inner], atol=ROUNDING, rtol=ROUNDING)
    assert_allclose(motion.f, solution.f[inner], atol=ROUNDING, rtol=ROUNDING)
    if kind not in ("classic", "minimal coordinates"):  # whose points are on no polynomial of all joints
        assert apart(solution, motion.q, solution.q[inner]) < SOLVED
        assert_allclose(motion.v, solution.v[inner], atol=SOLVED)
        assert_allclose(motion.a, solution.a[inner], atol=SOLVED)


def test_dynamics_hold_at_points_and_as_reported_between_them(kind: str, solution: Solution) -> None:
    if kind == "a rigid body":
        pytest.skip("its feet are no frames of the model")
    base = range(0 if kind != "velocity" else solution.n_unactuated, solution.model.nv)
    scale = NaturalUnits.of(solution.model).generalized_force(solution.model)
    rows = np.flatnonzero(solution.collocation)
    inner = rows[~np.isin(solution.t[rows], solution.interval_t)]
    if kind not in ("classic", "minimal coordinates"):
        missed = equation_of_motion(solution, solution.sample(times=solution.t[inner]))
        assert_allclose((missed / scale)[:, base], 0.0, atol=SOLVED)
    reported = figures_between_points(MotionQuantities.normalized(solution)).residuals
    largest = max(reported.base.max(initial=0.0), reported.actuated.max(initial=0.0))
    missed = equation_of_motion(solution, solution.sample(200)) / scale
    assert np.abs(missed[:, base]).max() < LOOKED_ELSEWHERE * largest + SOLVED


def test_velocities_integrate_to_positions(solution: Solution) -> None:
    start, end = solution.interval_t[1]
    t = np.linspace(start, end, max(2, math.ceil((end - start) / 1e-4)))
    motion = solution.sample(times=t[1:-1])
    q = motion.q[0]
    for step, rate in zip(np.diff(motion.t), (motion.v[1:] + motion.v[:-1]) / 2, strict=True):
        q = pin.integrate(solution.model, q, step * rate)
    assert_allclose(pin.difference(solution.model, motion.q[-1], q), 0.0, atol=QUADRATURE)


def test_every_kind_has_names_for_all_entries(solution: Solution) -> None:
    motion = solution.sample(100)
    for names, values in (
        (motion.position_names, motion.q),
        (motion.velocity_names, motion.v),
        (motion.torque_names, motion.tau),
        (motion.contact_frames, motion.active),
        (motion.angle_names, motion.angle),
    ):
        assert len(names) == len(set(names)) == values.shape[1]
    assert motion.joint_names == tuple(solution.model.names)[1:]
    assert set(motion.contact_frames) <= set(solution.frame_names)
    assert motion.joint_position.shape == motion.joint_velocity.shape == motion.tau.shape


def test_quaternions_do_not_change_sign(solution: Solution) -> None:
    motion = solution.sample(200)
    columns = [i for i, name in enumerate(motion.position_names) if name[-3:] in ("/qx", "/qy", "/qz", "/qw")]
    for first in range(0, len(columns), 4):
        own = motion.q[:, columns[first : first + 4]]
        assert (np.sum(own[1:] * own[:-1], axis=1) > 0.9).all()


def test_a_rate_gives_even_times_and_the_end(hop: Solution) -> None:
    motion = hop.sample(rate=500)  # 0.8 s
    assert_allclose(motion.t, np.arange(401) / 500, atol=1e-12)
    odd = hop.sample(rate=7)  # 5.6 periods
    assert_allclose(odd.t, [*np.arange(6) / 7, 0.8], atol=1e-12)
    assert_allclose(hop.sample(1e-9).t, [0.0, 0.8])
    assert (np.diff(hop.sample(1e5).t) > 0).all()


def test_without_rate_or_times_every_time_of_the_solution_comes_once(hop: Solution) -> None:
    motion = hop.sample()
    assert_allclose(motion.t, np.unique(np.round(hop.t, 12)))
    assert motion.t[-1] == hop.t[-1]


def test_times_come_in_the_order_given(hop: Solution) -> None:
    shuffled, ordered = hop.sample(times=[0.5, 0.1, 0.5]), hop.sample(times=[0.1, 0.5])
    assert_array_equal(shuffled.q, ordered.q[[1, 0, 1]])
    assert_array_equal(hop.sample(times=0.5).q, ordered.q[1:])


def test_touchdown_belongs_to_the_landing_unless_the_side_before_is_asked_for(hop: Solution) -> None:
    # As a caller computes it, not as the solver did.
    for t in (0.5, 0.3 + 0.2, 0.5 + 1e-12, 0.5 - 1e-12):
        after, before = hop.sample(times=[t]), hop.sample(times=[t], side="before")
        assert (after.active[0, 0], before.active[0, 0]) == (True, False)
        assert [motion.phase_names[motion.phase[0]] for motion in (after, before)] == ["landing", "flight"]
        assert_allclose(before.f, 0.0)


def test_an_impact_is_a_jump_of_velocity_at_one_time() -> None:
    solution = solution_of_kind("an impact")
    row = int(solution.impact_index[0])
    after, before = (solution.sample(times=[solution.t[row]], side=side) for side in ("after", "before"))
    assert np.abs(after.v - before.v).max() > 0.1
    assert_allclose(after.v[0], solution.v[row], atol=SOLVED)
    assert_allclose(before.v[0], solution.v[row - 1], atol=SOLVED)
    assert_allclose(after.q, before.q, atol=SOLVED)


def test_what_lies_beyond_the_points_of_an_interval_is_marked(hop: Solution) -> None:
    assert not hop.sample(times=hop.t[hop.collocation]).extrapolated.any()
    assert hop.sample(times=hop.interval_t[:, 0]).extrapolated.all()
    start, end = hop.interval_t[0]
    assert not hop.sample(times=[(start + end) / 2]).extrapolated[0]
    assert not solution_of_kind("one point").sample(200).extrapolated.any()  # a constant


@pytest.mark.long
@pytest.mark.parametrize("kind", ["points", "planar base"])
def test_base_velocity_in_world_axes_is_that_of_the_bases_origin(kind: str) -> None:
    solution, step = solution_of_kind(kind), 1e-5
    model, data = solution.model, solution.model.createData()
    t = solution.t[solution.collocation]
    own, world = solution.sample(times=t), solution.sample(times=t, base_velocity="world")
    near = [solution.sample(times=t + d, base_velocity="world") for d in (-step, step)]
    size = model.joints[1].nv
    rows = [0, 1, 2, 3, 4, 5] if size == 6 else [0, 1, 5]
    placed = model.jointPlacements[1].rotation.T
    for k in range(len(t)):
        pin.forwardKinematics(model, data, own.q[k], own.v[k], own.a[k])
        turn = placed @ data.oMi[1].rotation
        twist = np.concatenate([turn @ data.v[1].linear, turn @ data.v[1].angular])
        assert_allclose(world.v[k, :size], twist[rows], atol=1e-12)
    linear = slice(0, 3 if size == 6 else 2)
    rate = (near[1].q[:, linear] - near[0].q[:, linear]) / (2 * step)
    assert_allclose(world.v[:, linear], rate, atol=1e-5)  # third derivatives are below 1e5
    change = (near[1].v[:, :size] - near[0].v[:, :size]) / (2 * step)
    assert_allclose(world.a[:, :size], change, atol=1e-3)
    assert_array_equal(world.v[:, size:], own.v[:, size:])
    assert world.velocity_names[0] == "base/linear_x_world"
    assert own.velocity_names[0] == "base/linear_x_body"


def test_quaternions_come_in_either_order_and_names_follow(hop: Solution) -> None:
    xyzw, wxyz = hop.sample(100), hop.sample(100, quaternion="wxyz")
    assert xyzw.position_names[3:7] == ("base/qx", "base/qy", "base/qz", "base/qw")
    assert wxyz.position_names[3:7] == ("base/qw", "base/qx", "base/qy", "base/qz")
    assert_array_equal(wxyz.q[:, 3:7], xyzw.q[:, [6, 3, 4, 5]])
    assert_array_equal(np.delete(wxyz.q, range(3, 7), axis=1), np.delete(xyzw.q, range(3, 7), axis=1))
    assert (wxyz.quaternion, wxyz.base_velocity) == ("wxyz", "body")


@pytest.mark.long
def test_angles_of_continuous_joints_move_with_their_velocity_whatever_the_times() -> None:
    solution = solution_of_kind("continuous joints")
    motion = solution.sample(1000)
    assert motion.angle_names == ("j2s6s200_joint_1", "j2s6s200_joint_4", "j2s6s200_joint_6")
    mean = (motion.v[1:] + motion.v[:-1]) / 2 * np.diff(motion.t)[:, None]
    rows = [motion.velocity_names.index(name) for name in motion.angle_names]
    assert_allclose(np.diff(motion.angle, axis=0), mean[:, rows], atol=QUADRATURE)
    assert_allclose(np.diff(motion.joint_position, axis=0), mean, atol=QUADRATURE)
    ends = solution.sample(times=motion.t[[0, -1]])
    assert_allclose(ends.angle, motion.angle[[0, -1]], atol=1e-12)


@pytest.mark.long
def test_torques_of_drives_overcome_friction() -> None:
    solution = solution_of_kind("drives")
    motion = solution.sample(times=solution.t[solution.collocation])
    assert motion.has_drives
    assert_allclose(motion.drive_torque, solution.drive_torque[solution.collocation], atol=ROUNDING)
    plain = solution_of_kind("points").sample(100)
    assert not plain.has_drives
    assert_array_equal(plain.drive_torque, plain.tau)


def test_a_simulated_motion_is_sampled_too(hop: Solution) -> None:
    pytest.importorskip("mujoco")
    from trajopt.simulation.simulate import simulate

    simulated = simulate(hop).as_solution()
    motion = simulated.sample(250)
    nodes = simulated.sample(times=simulated.interval_t[:, 0])
    assert apart(simulated, nodes.q, simulated.q[[rows.start for rows in simulated.intervals]]) < ROUNDING
    assert motion.phase_names == simulated.phase_names


def test_samples_cannot_be_changed(hop: Solution) -> None:
    motion = hop.sample(100)
    with pytest.raises(ValueError, match="read-only"):
        motion.q[0, 0] = 1.0
    with pytest.raises(FrozenInstanceError):
        motion.t = motion.t


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"rate": 0}, "rate is 0 Hz; allowed: finite and > 0"),
        ({"rate": -5.0}, "rate is -5 Hz"),
        ({"rate": math.nan}, "rate is nan Hz"),
        ({"rate": math.inf}, "rate is inf Hz"),
        ({"rate": "500"}, "rate is '500' Hz"),
        ({"rate": True}, "rate is True Hz"),
        ({"rate": [500]}, "rate is [500] Hz"),
        ({"rate": 1e12}, "rate is 1e+12 Hz, 8e+11 samples in 0.8 s; allowed: 200000 samples"),
        ({"rate": 100, "times": [0.1]}, "rate and times are both given"),
        ({"times": []}, "times are 0 numbers"),
        ({"times": "now"}, "times are 'now'"),
        ({"times": ["0.1"]}, "times are ['0.1']"),
        ({"times": [[0.1], [0.2]]}, "times are [[0.1], [0.2]]"),
        ({"times": [[0.1], [0.2, 0.3]]}, "times are"),
        ({"times": [0.1, 0.9]}, "times[1] is 0.9 s; allowed: within the motion, 0 to 0.8 s"),
        ({"times": [-1e-3]}, "times[0] is -0.001 s"),
        ({"times": [0.1, math.nan]}, "times[1] is nan s"),
        ({"times": [math.inf]}, "times[0] is inf s"),
        ({"times": [None]}, "times are [None]"),
        ({"rate": 100, "side": "left"}, "side is 'left'; allowed: 'after' or 'before'"),
        ({"rate": 100, "quaternion": "xyz"}, "quaternion is 'xyz'; allowed: 'xyzw' or 'wxyz'"),
        ({"rate": 100, "base_velocity": "local"}, "base_velocity is 'local'; allowed: 'body' or 'world'"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(hop: Solution, given: dict[str, object], words: str) -> None:
    assert_refused_in_one_line(lambda: hop.sample(**given), words)


@pytest.mark.parametrize("name", ["t", "q", "v", "a", "tau", "f", "interval_t"])
def test_a_solution_with_nan_is_refused(hop: Solution, name: str) -> None:
    broken = getattr(hop, name).copy()
    broken[5] = math.nan
    assert_refused_in_one_line(
        lambda: replace(hop, **{name: broken}).sample(100), f"'{name}' holds NaN or infinity, first at (5"
    )


FLAGS = ("active/foot", "extrapolated")


@pytest.fixture(scope="module")
def motion() -> SampledMotion:
    return solution_of_kind("points").sample(200, quaternion="wxyz", base_velocity="world")


def test_columns_have_the_names_of_entries(motion: SampledMotion) -> None:
    columns = motion.columns
    assert list(columns)[:6] == ["t", "phase", "q/base/x", "q/base/y", "q/base/z", "q/base/qw"]
    assert "v/base/angular_z_world" in columns
    for group in ("q", "v", "a", "tau"):
        assert {f"{group}/hip", f"{group}/shank"} <= set(columns)
    assert [name for name in columns if name.startswith(("active", "force", "moment"))] == [
        "active/foot", "force/foot/x", "force/foot/y", "force/foot/z",
    ]  # fmt: skip
    assert_array_equal(columns["force/foot/z"], motion.f[:, 0, 2])
    assert_array_equal(columns["tau/shank"], motion.tau[:, 1])
    assert list(dict.fromkeys(columns["phase"])) == ["stance", "flight", "landing"]


@pytest.mark.long
def test_soles_have_moments_and_drives_torques_of_their_own() -> None:
    soles = solution_of_kind("soles").sample(50).columns
    assert "moment/left_sole_link/y" in soles
    assert not any(name.startswith("drive_torque/") for name in soles)
    drives = solution_of_kind("drives").sample(50).columns
    assert "drive_torque/FL_KFE" in drives
    assert "angle/j2s6s200_joint_1" in solution_of_kind("continuous joints").sample(50).columns


def test_a_data_frame_has_the_columns_and_says_its_conventions(motion: SampledMotion) -> None:
    frame = motion.to_pandas()
    assert list(frame.columns) == list(motion.columns)
    for name, values in motion.columns.items():
        assert_array_equal(frame[name].to_numpy(), values)
    assert (frame.attrs["quaternion"], frame.attrs["base_velocity"]) == ("wxyz", "world")


def test_to_pandas_takes_the_arguments_of_sample() -> None:
    solution = solution_of_kind("points")
    assert len(solution.to_pandas(rate=100)) == 81
    assert len(solution.to_pandas(times=[0.1, 0.5])) == 2
    assert solution.to_pandas()["t"].is_unique


def test_csv_keeps_every_bit(motion: SampledMotion, tmp_path: Path) -> None:
    path = motion.save(tmp_path / "motion.csv")
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(motion.t)
    for name, values in motion.columns.items():
        read = [row[name] for row in rows]
        assert_array_equal(read if name == "phase" else np.array(read, dtype=float), values)
    frame = pd.read_csv(path)
    assert list(frame.columns) == list(motion.columns)
    assert set(frame["active/foot"]) == {0, 1}


def test_parquet_keeps_types_and_conventions(motion: SampledMotion, tmp_path: Path) -> None:
    path = motion.save(tmp_path / "motion.parquet")
    frame = pd.read_parquet(path)
    for name, values in motion.columns.items():
        assert_array_equal(frame[name].to_numpy(), values)
        assert name not in FLAGS or frame[name].dtype == bool
    found = {key.decode(): value.decode() for key, value in pq.read_schema(path).metadata.items()}
    assert found == motion.facts


def test_npz_has_all_fields_without_pickles(motion: SampledMotion, tmp_path: Path) -> None:
    path = motion.save(tmp_path / "motion.npz")
    with np.load(path, allow_pickle=False) as archive:
        read = {name: archive[name] for name in archive.files}
    for name, values in motion.arrays.items():
        assert_array_equal(read[name], values)
    for name in (
        "position_names",
        "velocity_names",
        "torque_names",
        "contact_frames",
        "contact_names",
        "phase_names",
    ):
        assert tuple(read[name]) == getattr(motion, name)
    assert (str(read["quaternion"]), str(read["base_velocity"])) == ("wxyz", "world")


@pytest.mark.parametrize("name", ["motion.txt", "motion", "motion.xlsx"])
def test_unknown_endings_are_refused(motion: SampledMotion, tmp_path: Path, name: str) -> None:
    assert_refused_in_one_line(lambda: motion.save(tmp_path / name), "allowed: .csv, .parquet, .npz")
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_named(motion: SampledMotion, tmp_path: Path) -> None:
    assert_refused_in_one_line(lambda: motion.save(tmp_path / "no" / "motion.csv"), "cannot write")


def test_a_missing_package_is_named(
    motion: SampledMotion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match="needs pandas, which is not installed; pip install pandas"):
        motion.to_pandas()
    old = tmp_path / "motion.parquet"
    old.write_text("kept")
    with pytest.raises(InputError, match="needs pyarrow, which is not installed; pip install pyarrow"):
        motion.save(old)
    assert old.read_text() == "kept"

"""Samples of a motion as a table and as files: nothing is lost, names and conventions are in the file."""

import csv
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_array_equal

from tests.support.refusals import assert_refused_in_one_line
from tests.support.sampled_problems import solution_of_kind
from trajopt.errors import InputError
from trajopt.solution.sampled_motion import SampledMotion

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

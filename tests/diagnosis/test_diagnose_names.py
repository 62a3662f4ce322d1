"""Names of unknowns and rows in a diagnosis say what they are."""

import numpy as np
import pytest

import trajopt
from tests.support.diagnosed import snapshot_of, solved
from trajopt.diagnosis.diagnose import diagnose
from trajopt.diagnosis.snapshot import Snapshot
from trajopt.robot.units import Units
from trajopt.solving.extraction import extract
from trajopt.solving.solving import prepare
from trajopt_library import problems


def test_a_solutions_own_unknowns_and_multipliers_are_stationary():
    problem, solution = solved("hop")
    snapshot = snapshot_of(problem, solution)
    assert snapshot.stationarity is not None
    assert snapshot.stationarity < 1e-5
    assert snapshot.complementarity < 1e-5
    assert snapshot.violations.max() < 1e-6


@pytest.mark.long
def test_an_unknown_changes_what_its_name_says():
    problem, solution = solved("hop")
    snapshot = snapshot_of(problem, solution)
    transcription, names = snapshot.transcription, snapshot.names
    model, before = problem.robot.model, extract(transcription, snapshot.x, success=True, converged=True)
    seen = set()
    for index in range(0, len(snapshot.x), 7):
        label, site = names.unknown_labels[index], names.unknown_sites[index]
        if label.owner in ("base", "") or label.kind == "time scale":
            continue
        moved = snapshot.x.copy()
        moved[index] += 0.1
        after = extract(transcription, moved, success=True, converged=True)
        arrays = {"position": "q", "rate": "v", "acceleration": "a", "force": "f"}
        array = arrays[label.kind]
        changed = np.abs(getattr(after, array) - getattr(before, array)).reshape(len(before.t), -1) > 1e-6
        at = np.abs(before.t - names.time(site)) < 1e-9
        if label.kind == "force":
            column = {"x": 0, "y": 1, "z": 2}[label.quantity[-1]]
        else:
            joint = model.joints[model.getJointId(label.owner)]
            column = joint.idx_q if label.kind == "position" else joint.idx_v
        assert changed[at][:, column].any(), names.unknown_labels[index]
        others = np.delete(changed[at & before.collocation], column, axis=1)
        if site.point >= 0:
            assert not others.any(), names.unknown_labels[index]
        seen.add(label.kind)
    assert seen == {"position", "rate", "acceleration", "force"}


def test_a_row_of_a_limit_is_the_torque_that_its_name_says():
    problem, solution = solved("hop")
    snapshot = snapshot_of(problem, solution)
    names, unit = snapshot.names, Units(problem.robot).torque
    rows = [row for row in range(len(snapshot.g)) if names.block(row) == "torque_limits"]
    assert len(rows) == 2 * 2 * 8
    joints = list(problem.robot.model.names)[2:]
    for row in rows:
        name = names.row(row)
        assert name.about in [f"{joint} torque" for joint in joints]
        column = joints.index(name.about.split()[0])
        sample = int(np.argmin(np.abs(solution.t - names.time(name.site)) + ~solution.collocation))
        assert snapshot.g[row] * unit == pytest.approx(solution.tau[sample, column], abs=1e-6 * unit)


def test_rows_are_named_by_contact_axis_and_state():
    problem, solution = solved("hop")
    names = snapshot_of(problem, solution).names
    texts = {names.row(row).what for row in range(names.transcription.n_rows)}
    assert "contact_acceleration [foot acceleration y]" in texts
    assert "base_dynamics [base turn about x balance]" in texts
    assert "contact_landing [foot position z]" in texts
    assert "frame_height [foot position z]" in texts
    assert "defect [hip rate]" in texts
    assert "velocity_limits [shank rate]" in texts


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("hopper-hop", {"touchdown": "impact"}, {"jump", "impulse", "force"}),
        ("hopper-hop", {"coordinates": "minimal"}, {"position", "rate", "acceleration"}),
        ("hopper-hop", {"goal": "time"}, {"time scale"}),
        ("hopper-gait", {}, {"position", "rate"}),
        ("ur5-reach", {"actuation": "velocity"}, {"position", "rate"}),
        ("arm-pick-place", {}, {"position"}),
    ],
)
def test_every_unknown_and_row_has_a_name(name, values, expected):
    prepared = prepare(problems.load(name, **values), intervals=8)
    snapshot = Snapshot(nlp=prepared.nlp, x=prepared.guess)
    names = snapshot.names
    assert all(label.owner and label.quantity for label in names.unknown_labels)
    assert expected <= {label.kind for label in names.unknown_labels}
    pairs = list(zip(names.unknown_labels, names.unknown_sites, strict=True))
    assert len(set(pairs)) == len(pairs)
    rows = [names.row(row) for row in range(prepared.transcription.n_rows)]
    assert len(set(rows)) == len(rows)
    assert not [row for row in rows if row.about.startswith("row ") and "mostly" not in row.about]


@pytest.mark.slow
def test_the_jump_at_its_defaults_is_clean():
    problem = problems.load("solo12-jump")
    solution = trajopt.solve(problem, fixed_mesh=True)
    found = diagnose(solution)  # its problem from the catalogue
    assert found.variables == 4575
    assert found.clean, [str(advice) for advice in found.advice]
    snapshot = snapshot_of(problem, solution)
    matrix = snapshot.jacobian[snapshot.active_rows][:, snapshot.free]
    flight = [i for i, row in enumerate(snapshot.active_rows) if names_phase(snapshot, int(row)) == "flight"]
    values = np.linalg.svd(matrix[flight].toarray(), compute_uv=False)
    report = next(report for report in found.ranks if report.phase == "flight")
    assert (report.rows, report.rank) == (len(flight), len(flight))
    assert report.condition == pytest.approx(values[0] / values[-1], rel=1e-3)


def names_phase(snapshot: Snapshot, row: int) -> str:
    return snapshot.names.phase(snapshot.names.sites[row].stage)

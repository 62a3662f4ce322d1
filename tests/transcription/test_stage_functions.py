"""Derivatives of point functions by the chain rule, and the cache of compiled ones."""

import errno
import os
import subprocess
import sys
import warnings
from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.problems import (
    FOOT,
    hop,
    hopper,
    one_joint_arm,
    planar_hopper,
    point_of,
    random_point,
    reach,
)
from tests.support.processes import LIMIT, environment
from trajopt import Problem, Robot, _engine, terms
from trajopt.cache import CACHE_VARIABLE
from trajopt.dynamics import Coordinates
from trajopt.robot import LinkWrench, Units
from trajopt.robot.link_wrench import wrench_force
from trajopt.solving.solving import prepare
from trajopt.transcription import Derivatives, transcribe
from trajopt.transcription.compilation import compile_points, entry_key
from trajopt.transcription.stage_functions import PointFunction
from trajopt_library import robots

# Two graphs of one function in double precision, entries up to a few hundred.
SAME = {"rtol": 1e-9, "atol": 1e-9}
SEEDS = (0, 1)
COSTS = (terms.TorqueCost, terms.AccelerationCost, terms.VelocityCost, terms.PostureCost, terms.WrenchCost)
LIMITS = (
    terms.TorqueLimits(),
    terms.PositionLimits(),
    terms.VelocityLimits(),
    terms.FrictionCone(friction=0.7),
)
TERMS = (*(cost(weight=0.3 + i) for i, cost in enumerate(COSTS)), *LIMITS)
FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
# Of the second derivatives of Solo12 on four feet; 43k at the time of writing.
STANCE_STATEMENTS = 50_000


class PlainContext(terms.Context):
    """A point whose robot is evaluated in world axes, whatever its base."""

    has_free_flyer = False


def turned_hopper() -> Robot:
    """The hopper with its root joint's axes turned against the world's."""
    model = hopper().model.copy()
    model.jointPlacements[1] = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.3, 0.2), np.array([0.1, 0.0, 0.2]))
    return Robot.from_model(model, contacts=hopper().contacts, name="turned")


@lru_cache
def case(name: str) -> tuple[Robot, tuple[str, ...]]:
    return {
        "solo12-stance": lambda: (robots.load("solo12"), FEET),
        "solo12-flight": lambda: (robots.load("solo12"), ()),
        "ur5": lambda: (robots.load("ur5"), ()),
        "planar-stance": lambda: (planar_hopper(), (FOOT,)),
        "sole": lambda: (hopper("surface"), (FOOT,)),
        "hopper": lambda: (hopper(), (FOOT,)),
        "turned": lambda: (turned_hopper(), (FOOT,)),
        "arm": lambda: (one_joint_arm(gravity=True), ()),
    }[name.removesuffix(" in wind")]()


FREE_FLYING = ("solo12-stance", "solo12-flight", "sole", "hopper", "solo12-stance in wind")
CASES = (*FREE_FLYING, "ur5", "planar-stance", "arm", "ur5 in wind")


def wind(name: str) -> tuple[LinkWrench, ...]:
    """Two wrenches of a case in wind, off the origin of a frame of the last link."""
    if not name.endswith(" in wind"):
        return ()
    frame = case(name)[0].model.frames[-1].name
    given = {"frame": frame, "force": (3.0, -2.0, 5.0), "torque": (0.4, 0.5, -0.6)}
    return LinkWrench(**given, point=(0.1, -0.2, 0.3)), LinkWrench(frame=frame, force=(0.0, 1.0, 0.0))


@lru_cache
def built(name: str) -> tuple[PointFunction, np.ndarray, Derivatives]:
    robot, contacts = case(name)
    all_terms = (*TERMS, terms.SoleLimits(friction=0.7)) if name == "sole" else TERMS
    point, parameters = point_of(robot, contacts, all_terms, given=wind(name))
    return point, parameters, Derivatives(point)


def composed(point: PointFunction, z: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Cost and rows with all layers put into one graph."""
    o = point.robot_inputs(z, p)
    for layer in point.layers:
        o = layer(o)
    return point.terms(z, o if point.layers else ca.SX(0, 1), p)


@pytest.mark.parametrize("name", CASES)
def test_first_derivatives_equal_those_of_the_composed_graph(name):
    point, p, made = built(name)
    z, parameters, along = ca.SX.sym("z", point.n_z), ca.SX.sym("p", len(p)), ca.SX.sym("along", point.n_z)
    cost, rows = composed(point, z, parameters)
    direct = [cost, rows, ca.gradient(cost, z), ca.jtimes(rows, z, along)]
    reference = ca.Function("reference", [z, parameters, along], direct)
    for seed in SEEDS:
        generator = np.random.default_rng(seed)
        at, direction = random_point(case(name)[0], point, generator), generator.uniform(-1, 1, point.n_z)
        expected = [np.array(part) for part in reference(at, p, direction)]
        *values, slope, jacobian = (np.array(part) for part in made.first(at, p))
        for value, exact in zip((*values, slope, jacobian @ direction[:, None]), expected, strict=True):
            assert_allclose(value, exact, **SAME)
        for value, exact in zip(made.value(at, p), expected, strict=False):
            assert_allclose(np.array(value), exact, **SAME)


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_second_derivatives_equal_those_of_the_composed_graph(name):
    point, p, made = built(name)
    z, parameters, along = ca.SX.sym("z", point.n_z), ca.SX.sym("p", len(p)), ca.SX.sym("along", point.n_z)
    sigma, multiplier = ca.SX.sym("sigma"), ca.SX.sym("lambda", point.n_rows)
    cost, rows = composed(point, z, parameters)
    slope = ca.gradient(sigma * cost + ca.dot(multiplier, rows), z)
    inputs = [z, parameters, sigma, multiplier, along]
    reference = ca.Function("reference", inputs, [ca.jtimes(slope, z, along)])
    for seed in SEEDS:
        generator = np.random.default_rng(seed)
        at, direction = random_point(case(name)[0], point, generator), generator.uniform(-1, 1, point.n_z)
        weights = generator.uniform(-1, 1, point.n_rows)
        lower = np.array(made.second(at, p, 1.3, weights))
        assert_allclose(np.triu(lower, 1), 0.0)
        symmetric = lower + np.tril(lower, -1).T
        expected = np.array(reference(at, p, 1.3, weights, direction)).ravel()
        assert_allclose(symmetric @ direction, expected, **SAME)


@pytest.mark.parametrize("name", FREE_FLYING)
def test_base_axes_give_the_values_of_world_axes(name):
    robot, contacts = case(name)
    point, p = point_of(robot, contacts, TERMS, given=wind(name))
    plain, plain_p = point_of(robot, contacts, TERMS, PlainContext, given=wind(name))
    assert (len(point.layers), len(plain.layers)) == (4, 2)
    assert_allclose(p, plain_p)
    first, second = Derivatives(point).value, Derivatives(plain).value
    turned = slice(6, 6 + sum(robot.contact(contact).dimension for contact in contacts))
    for seed in SEEDS:
        at = random_point(robot, point, np.random.default_rng(seed))
        cost, rows = (np.array(part).ravel() for part in first(at, p))
        plain_cost, plain_rows = (np.array(part).ravel() for part in second(at, p))
        rotation = pin.Quaternion(state(robot, contacts, at)[0][3:7]).toRotationMatrix()
        acceleration = rows[turned].reshape(-1, 3) @ rotation.T  # of the contacts: from base to world axes
        assert_allclose(acceleration.ravel(), plain_rows[turned], **SAME)
        rest = np.delete(np.arange(len(rows)), turned)
        assert_allclose([*cost, *rows[rest]], [*plain_cost, *plain_rows[rest]], **SAME)


def state(robot: Robot, contacts: tuple[str, ...], z: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pinocchio's (q, v, a) and the wrenches of a point's inputs."""
    coordinates, nv = Coordinates(robot.model), robot.nv
    n4 = 4 * coordinates.n_rotations
    parts = np.split(z, [n4, n4 + nv, n4 + 2 * nv, n4 + 3 * nv])
    q, v, a = (part[0] for part in coordinates.local_to_pinocchio(*(part[None] for part in parts[:4])))
    sizes = np.cumsum([robot.contact(name).dimension for name in contacts])
    return q, v, a, np.split(parts[4], sizes)[:-1] if len(sizes) else []


def jacobian(robot: Robot, name: str, q: np.ndarray) -> np.ndarray:
    contact, data = robot.contact(name), robot.model.createData()
    frame = robot.model.getFrameId(contact.frame)
    return pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[list(contact.rows)]


STANDING = ("solo12-stance", "solo12-flight", "planar-stance", "sole", "turned")


@pytest.mark.parametrize("name", [*STANDING, "solo12-stance in wind", "planar-stance in wind"])
def test_base_rows_equal_numeric_dynamics_under_the_contact_wrenches(name):
    robot, contacts = case(name)
    point, p = point_of(robot, contacts, (), given=wind(name))
    value = Derivatives(point).value
    for seed in SEEDS:
        at = random_point(robot, point, np.random.default_rng(seed))
        q, v, a, wrenches = state(robot, contacts, at)
        expected = pin.rnea(robot.model, robot.model.createData(), q, v, a)
        for contact, wrench in zip(contacts, wrenches, strict=True):
            expected = expected - jacobian(robot, contact, q).T @ wrench
        expected = expected - wrench_force(robot.model, wind(name), 0.0, q)
        n = robot.n_unactuated
        assert_allclose(np.array(value(at, p)[1]).ravel()[:n], expected[:n], **SAME)


@pytest.mark.parametrize("name", ["solo12-stance", "planar-stance", "sole", "turned"])
def test_contact_rows_are_as_large_as_the_numeric_classical_acceleration(name):
    robot, contacts = case(name)
    point, p = point_of(robot, contacts, ())
    value, data = Derivatives(point).value, robot.model.createData()
    for seed in SEEDS:
        at = random_point(robot, point, np.random.default_rng(seed))
        q, v, a, _ = state(robot, contacts, at)
        pin.forwardKinematics(robot.model, data, q, v, a)
        rows = np.array(value(at, p)[1]).ravel()[robot.n_unactuated :]
        start = 0
        for contact in map(robot.contact, contacts):
            frame = robot.model.getFrameId(contact.frame)
            motion = pin.getFrameClassicalAcceleration(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            for part in (range(3), range(3, 6)):  # linear, angular: axes may be turned, lengths are not
                taken = [row for row in contact.rows if row in part]
                length = np.linalg.norm(rows[start : start + len(taken)])
                assert_allclose(length, np.linalg.norm(motion.vector[taken]), **SAME)
                start += len(taken)


def test_terms_without_the_robot_need_no_layers():
    robot = robots.load("ur5")
    point, p = point_of(robot, (), (terms.AccelerationCost(weight=2.0), terms.PositionLimits()))
    assert point.layers == ()
    at = random_point(robot, point, np.random.default_rng(0))
    expected = 2.0 * np.mean((at[12:] / Units(robot).acceleration) ** 2)
    assert float(Derivatives(point).value(at, p)[0]) == pytest.approx(expected)


def test_contact_rows_vanish_for_nobody_in_contact():
    robot, context = hopper(), terms.Context(hopper(), Coordinates(hopper().model), (), node=False)
    assert terms.ContactAcceleration().rows(context, Units(robot)) is None


def test_second_derivatives_of_a_quadruped_in_stance_stay_small():
    *_, made = built("solo12-stance")
    assert _engine.Tape(made.second).statements < STANCE_STATEMENTS


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    """An empty cache folder."""
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    return folder


# Code may not grow with the degree of the scheme.
CODE_GROWTH = 1.0


def points_of(problem: Problem, transcription: str = "legendre:2", intervals: int = 6) -> list[PointFunction]:
    groups = transcribe(problem, transcription, intervals).groups
    return list({id(group.point): group.point for group in groups}.values())


def entries(folder: Path) -> set[str]:
    return {entry.name for entry in folder.iterdir() if not entry.name.startswith(".")}


def test_second_time_everything_comes_from_the_cache(cache):
    points = points_of(hop())
    compiled, first = compile_points(points)
    made = entries(cache)
    _, second = compile_points(points)
    assert (first.cached, first.built) == (0, 3 * len(compiled))
    assert (second.cached, second.built) == (first.built, 0)
    assert entries(cache) == made
    assert {entry.split(".")[0] for entry in made} == set(compiled)


def test_landing_after_stance_shares_its_code(cache):
    points = points_of(hop())
    assert {"stance", "flight", "landing"} < {point.name for point in points}
    compiled, _ = compile_points(points)
    assert len(compiled) < len(points)


@pytest.mark.long
def test_parameters_scheme_and_intervals_add_no_entry(cache):
    compile_points(points_of(hop()))
    made = entries(cache)
    all_terms = [
        terms.TorqueCost(weight=7.0) if isinstance(term, terms.TorqueCost) else term for term in hop().terms
    ]
    for changed in (
        points_of(hop(terms=tuple(all_terms))),
        points_of(hop(), "radau:3", 11),
        points_of(hop(), "trapezoidal", 5),
    ):
        _, report = compile_points(changed)
        assert report.built == 0
    assert entries(cache) == made


def test_friction_coefficient_is_a_parameter(cache):
    first, second = (points_of(hop(terms=(terms.FrictionPyramid(friction=mu),))) for mu in (0.4, 0.9))
    assert [entry_key(point) for point in first] == [entry_key(point) for point in second]


def test_another_mass_is_another_entry():
    light, heavy = points_of(hop()), points_of(hop(robot=hopper(mass=3.5)))
    assert entry_key(light[0]) != entry_key(heavy[0])


def test_code_does_not_grow_with_the_degree(cache):
    sizes = [statements(points_of(hop(terms=()), f"legendre:{s}")) for s in (1, 3)]
    assert 0 < sizes[1] <= CODE_GROWTH * sizes[0]


def statements(points: list[PointFunction]) -> int:
    compiled, _ = compile_points(points)
    return sum(
        tape.statements for point in compiled.values() for tape in (point.value, point.first, point.second)
    )


def test_functions_from_the_cache_give_the_same_bits(cache):
    made, read = (prepare(hop(), transcription="legendre:2", intervals=6).nlp.engine for _ in range(2))
    x = np.linspace(-1, 1, made.n_x)
    multipliers = np.cos(np.arange(made.n_g))
    assert_array_equal(read.g(x), made.g(x))
    assert_array_equal(read.jacobian(x), made.jacobian(x))
    assert_array_equal(read.hessian(x, 1.0, multipliers), made.hessian(x, 1.0, multipliers))


def test_other_hessians_take_what_the_exact_one_has_left(cache):
    points = points_of(hop())
    _, exact = compile_points(points)
    _, no_second = compile_points(points, "limited-memory")
    _, gauss_newton = compile_points(points, "gauss-newton")
    assert (no_second.built, no_second.cached) == (0, exact.built * 2 // 3)
    assert (gauss_newton.built, gauss_newton.cached) == (exact.built // 3, exact.built * 2 // 3)


def test_a_cache_folder_that_cannot_be_written_is_said_once_and_done_without(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file" / "cache"))
    with pytest.warns(UserWarning, match=rf"file/cache cannot be written \(.*{CACHE_VARIABLE}") as told:
        made, report = compile_points(points_of(reach()))
    assert made
    assert report.cached == 0
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert compile_points(points_of(reach()))[1].built == report.built


def cut_off(entry: Path) -> None:
    entry.write_bytes(entry.read_bytes()[:-10])


def change_a_byte(entry: Path) -> None:
    text = bytearray(entry.read_bytes())
    text[len(text) // 2] ^= 1
    entry.write_bytes(text)


def empty(entry: Path) -> None:
    entry.write_bytes(b"")


@pytest.mark.parametrize("damage", [cut_off, change_a_byte, empty, Path.unlink])
def test_damaged_entry_is_made_anew(cache, damage):
    points = points_of(reach())
    _, first = compile_points(points)
    damage(cache / sorted(entries(cache))[0])
    _, report = compile_points(points)
    assert (report.built, report.cached) == (1, first.built - 1)
    assert compile_points(points)[1].built == 0


def test_full_disk_is_told_in_one_line_and_leaves_nothing(cache, monkeypatch):
    def full(path: Path, content: bytes) -> int:
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.warns(UserWarning, match=r"cannot be written \(No space left on device\)"):
        compile_points(points_of(reach()))
    assert list(cache.iterdir()) == []


COMPILE = """
from tests.support.problems import reach
from trajopt import solve
print(solve(reach(), transcription="legendre:2").statistics.status)
"""


@pytest.mark.long
def test_two_processes_may_fill_an_empty_cache_at_once(cache):
    known = environment(**{CACHE_VARIABLE: str(cache)})
    command = [sys.executable, "-c", COMPILE]
    processes = [
        subprocess.Popen(command, env=known, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in processes:
        out, error = process.communicate(timeout=LIMIT)
        assert out.split() == ["solved"], error
    assert [entry for entry in cache.iterdir() if entry.name.startswith(".")] == []
    assert compile_points(points_of(reach()))[1].built == 0

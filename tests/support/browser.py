"""A Chromium for tests, motions of any robot that need no solve, and where a page's scene has its parts."""

import contextlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from tests.support.synthetic_motions import Motion, sampled
from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.robot.robot import Robot
from trajopt.view.replay.browser import Chromium, OpenedPage, chromium, find_chromium

# A joint swings by half of the room it has, at most by so many rad or m.
MOST_SWING = 0.4
STANCE, FLIGHT = 0.4, 0.3  # s
PATIENCE = 100.0  # s that a page on a busy machine may take for what it does at once: below `CALL_LIMIT`
RISE = 0.3  # of the robot's length, in flight
INTERVALS = 4
# What takes the world of a solution to that of three.js, and back.
WORLD = """
    const tree = trajopt.viewer.scene_tree, root = tree.find(["meshcat"]).object;
    const at = path => tree.find(["meshcat", ...path.split("/")]).object;
    root.updateWorldMatrix(true, true);
    const back = root.matrixWorld.clone().invert();
"""
PLACES = """([paths, below]) => {%s
    const inverse = below ? at(below).matrixWorld.clone().invert() : back;
    return paths.map(path => at(path).matrixWorld.clone().premultiply(inverse).elements);
}"""
TO_PICTURE = """() => {%s
    const {camera} = trajopt.viewer;
    camera.updateMatrixWorld(true);
    return root.matrixWorld.clone().premultiply(camera.matrixWorldInverse)
        .premultiply(camera.projectionMatrix).elements;
}"""
BOXES = """paths => {%s
    const {Box3, Vector3} = MeshCat.THREE, point = new Vector3();
    return paths.map(path => {
        const box = new Box3();
        at(path).traverse(part => {
            if (!part.isMesh) return;
            const matrix = part.matrixWorld.clone().premultiply(back), {position} = part.geometry.attributes;
            for (let k = 0; k < position.count; k++) {
                box.expandByPoint(point.fromBufferAttribute(position, k).applyMatrix4(matrix));
            }
        });
        return [box.min.toArray(), box.max.toArray()];
    });
}"""
ONLY = """wanted => {
    for (const name of trajopt.layers) trajopt.layer(name, name === wanted);
    trajopt.render();
}"""
# Levels of a colour by which two pictures differ where something is drawn in one of them.
DIFFERENT = 24


def require_chromium() -> str:
    """Chromium's executable; where there is none the test is skipped, but in CI it fails."""
    try:
        return find_chromium()
    except InputError as error:
        if os.environ.get("CI"):
            raise
        pytest.skip(str(error))


@contextmanager
def running_chromium() -> Iterator[Chromium]:
    """A running Chromium, as `require_chromium` demands it."""
    require_chromium()
    with chromium() as running:
        yield running


def in_motion(robot: Robot) -> Solution:
    """Its joints swing about the reference; one with contacts stands on them, then takes off."""
    flight = _swinging(robot, FLIGHT, rises=robot.base != "fixed")
    phases = [_swinging(robot, STANCE, rises=False), flight] if robot.contacts else [flight]
    visual = None if robot.visual is None else robot.visual.to_meta()
    return sampled(robot, phases, INTERVALS, visual=visual, problem="in motion")


def _swinging(robot: Robot, duration: float, *, rises: bool) -> Motion:
    """Every joint moves away from where it is and back; a robot that rises goes up and down too."""
    swing, still = _swing(robot), np.zeros(robot.nv)
    force, names = np.zeros((len(robot.contacts), 6)), tuple(contact.name for contact in robot.contacts)
    if not rises:
        force[:, 2] = mass_of(robot.model) * gravity_of(robot.model) / max(len(names), 1)

    def q(t: float) -> np.ndarray:
        part = np.sin(np.pi * t / duration) ** 2
        moved = pin.integrate(robot.model, robot.reference, swing * part)
        if rises:
            moved[1 if robot.base == "planar" else 2] += RISE * robot.length * part
        return moved

    return Motion(
        duration=duration,
        contacts=() if rises else names,
        q=q,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: np.zeros(robot.nu),
        f=lambda t: force,
    )


def _swing(robot: Robot) -> np.ndarray:
    """How far every actuated joint goes (nv,): to the side where it has more room."""
    swing = np.zeros(robot.nv)
    for joint in list(robot.model.joints)[1:]:
        if joint.idx_v < robot.n_unactuated or joint.nv != 1:
            continue
        swing[joint.idx_v] = MOST_SWING
        if joint.nq == 1:  # a continuous joint has cosine and sine, and no limits
            above = robot.position_upper[joint.idx_q] - robot.reference[joint.idx_q]
            below = robot.reference[joint.idx_q] - robot.position_lower[joint.idx_q]
            room = min(max(above, below) / 2, MOST_SWING)
            swing[joint.idx_v] = room if above > below else -room
    return swing


def placements(view: OpenedPage, paths: list[str], below: str = "") -> np.ndarray:
    """Matrices (n, 4, 4) of parts of the scene tree in the world, or in that of the solution at ``below``."""
    return np.reshape(view.evaluate(PLACES % WORLD, [paths, below]), (-1, 4, 4)).transpose(0, 2, 1)


def boxes(view: OpenedPage, paths: list[str]) -> np.ndarray:
    """Lowest and highest corner (n, 2, 3) of the triangles of parts of the scene tree, in that world."""
    return np.array(view.evaluate(BOXES % WORLD, paths), dtype=float)


def pixels_of(view: OpenedPage, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Where in the picture (n, 2), x to the right and y down, points (n, 3) of the solution's world are."""
    matrix = np.reshape(view.evaluate(TO_PICTURE % WORLD), (4, 4)).T
    clip = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return (clip[:, :2] / clip[:, 3:] * [0.5, -0.5] + 0.5) * size


def drawn_by(view: OpenedPage, layer: str) -> np.ndarray:
    """The pixels (h, w) of one layer where nothing else hides it; the other layers are hidden from now on."""
    view.evaluate(ONLY, None)
    without = view.picture().astype(int)
    view.evaluate(ONLY, layer)
    return np.abs(view.picture() - without).max(axis=2) > DIFFERENT


def extent(mask: np.ndarray) -> np.ndarray:
    """Corners [[left, top], [right, bottom]] of what is set in ``mask`` (h, w), pixels."""
    rows, columns = np.nonzero(mask)
    return np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]])


def until(view: OpenedPage, script: str) -> None:
    """Wait until a JavaScript expression holds; fails if it does not within `PATIENCE`."""
    looking = f"""limit => new Promise(resolve => {{
        const holds = () => {script}, end = performance.now() + limit;
        const look = () => holds() || performance.now() > end ? resolve(holds()) : setTimeout(look, 20);
        look();
    }})"""
    assert view.evaluate(looking, 1e3 * PATIENCE), f"{script} never holds"


def descendants() -> dict[int, str]:
    """Name by number of every process that this one has started, directly or not."""
    parents, names = {}, {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has just ended
            number, name, rest = re.fullmatch(
                r"(\d+) \((.*)\) \S (\d+) .*", status.read_text(), re.S
            ).groups()
            parents[int(number)], names[int(number)] = int(rest), name
    found: dict[int, str] = {}
    mine = {os.getpid()}
    while mine:
        mine = {number for number, parent in parents.items() if parent in mine}
        found |= {number: names[number] for number in mine}
    return found

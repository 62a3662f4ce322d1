"""Carried bodies of a replay: where they are taken, with the hand that holds them, where they are left."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.certify.payloads import payload_inertia
from trajopt.solution.solution import Solution
from trajopt.view.replay.commands import Animation
from trajopt.view.replay.parts import placed
from trajopt.view.replay.robot import box_of_inertia
from trajopt.view.replay.runs import DrawnSolution
from trajopt.view.replay.thinning import hold_while_hidden

PAYLOAD_COLOUR = 0xC98A2B
# A point mass is drawn as a ball of this density, kg/m^3: between wood and water.
DENSITY = 800.0


def draw_payloads(run: DrawnSolution, tracks: Animation) -> np.ndarray:
    """Animate what is carried; returns places (k, 3) that it takes up, m, world."""
    solution, motion, places = run.solution, run.motion, [np.zeros((0, 3))]
    for number, (entry, phases) in enumerate(_bodies(solution)):
        contact = solution.contact_frames.index(entry["frame"])
        carried = np.isin(motion.phase, phases)
        if not carried.any():
            continue
        body, part = payload_inertia(entry), run.node["payloads"][f"body{number}"]
        extent = _draw(part["shape"], body)
        # It waits where it is taken, and stays where it is left.
        hand = hold_while_hidden(motion.contacts[:, contact], carried)
        tracks.place(part, hand)
        centres = hand[:, :3, :3] @ body.lever + hand[:, :3, 3]
        places += [centres - extent, centres + extent]
    return np.concatenate(places)


def _bodies(solution: Solution) -> list[tuple[dict[str, Any], list[int]]]:
    """Each carried body with the phases in which it is; a body is described once for every phase."""
    found: list[tuple[dict[str, Any], list[int]]] = []
    for entry in solution.meta.get("payloads") or []:
        body = {key: value for key, value in entry.items() if key != "phases"}
        same = [phases for other, phases in found if other == body]
        if same:
            same[0].extend(entry["phases"])
        else:
            found.append((body, list(entry["phases"])))
    return found


def _draw(node: Any, body: pin.Inertia) -> float:
    """A box of the body's mass and inertia, or a ball for a point; returns half its extent, m."""
    material = shapes.MeshLambertMaterial(color=PAYLOAD_COLOUR)
    box = box_of_inertia(body)
    if box is not None:
        sides, placement = box
        node.set_object(shapes.Box(sides.tolist()), material)
        node.set_transform(placement.homogeneous)
        return float(np.linalg.norm(sides)) / 2
    radius = float((3 * max(body.mass, 1e-6) / (4 * np.pi * DENSITY)) ** (1 / 3))
    node.set_object(shapes.Sphere(radius), material)
    node.set_transform(placed(body.lever))
    return radius

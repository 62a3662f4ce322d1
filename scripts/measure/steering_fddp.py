"""A step of the horizon beside one iteration of Crocoddyl's FDDP on the same horizon, in turns (docs/mpc.md).

The same robot, modes and durations, start, references of base, joints and feet, and weights of these and of
torques. Both begin at the optimum of a start that is slightly different; starts are the same for both. What
differs:

- Crocoddyl integrates knots by the symplectic Euler method with torques constant over each, 10 ms as is
  usual, or as many knots as ours has intervals, which are too long for it; ours is collocation of degree two.
- FDDP has no rows: friction is a quadratic barrier, landings are costs on height and velocity, limits of
  joints, rates and torques are left out. Ours has all of them as rows, with slacks and multipliers.
- FDDP's Hessian is Gauss and Newton's, without second derivatives of the dynamics. Ours is exact.
- Costs of forces and of accelerations of joints are in ours only.
- Crocoddyl is PyPI's wheel, for every x86-64; our engine takes the vector instructions that it finds.

An iteration is `SolverFDDP.solve` with one at most: dynamics, derivatives, backward pass, forward pass. Those
whose full step is not accepted take more forward passes and do not count; all of ours count. Times are CPU
times of the one thread of each, so that other processes disturb them less. Both halves are processes, as
Crocoddyl needs another Pinocchio; one of them computes at a time.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any

import click
import numpy as np
import pinocchio as pin

from scripts.measure.shared import head, median, row
from scripts.peers.halves import Half
from trajopt import _engine
from trajopt.dynamics import gravity_of
from trajopt.mpc import Command, Controller, Horizon, HorizonMotion
from trajopt.mpc.reference import Reference, reference_layout
from trajopt.robot import Contact, Robot
from trajopt.robot.units import Units
from trajopt_library import robots

PEER = "uv run --quiet scripts/peers/fddp.py"
# Knots of Crocoddyl's users, s.
KNOT = 0.01
FINE, COARSE = "fine", "coarse"
TICK = 0.01
# After which speeds are steady and ticks are timed, and how long they are, s.
STEADY, TIMED = 1.5, 4.0
GAITS = {"go2": "trot", "solo12": "trot", "anymal_c": "trot", "g1": "walk", "talos": "walk"}
# Speeds over sqrt(g l).
SPEEDS = {"trot": 0.4, "walk": 0.08}
# Standard deviations of starts: velocity over sqrt(g l), angular velocity over sqrt(g / l).
PUSH, SPIN = 0.003, 0.006
# Steps of the solve whose optimum a step begins at.
STEPS = 30
# Weights of Crocoddyl's costs that ours has as rows, over natural units: cone of forces, height and velocity
# of feet that land.
CONE, LANDING, TOUCHDOWN = 10.0, 100.0, 0.1
# Starts measured between those of the other side, after one that is not.
TURN = 4


@dataclass(frozen=True, kw_only=True)
class Steady:
    """A tick of a robot that moves just as planned.

    controller: as that tick left it. horizon, iterate: of its plan, at the optimum. q, v: at its begin.
    ticks: CPU times of those before, s.
    """

    controller: Controller
    horizon: Horizon
    iterate: _engine.Iterate
    q: np.ndarray
    v: np.ndarray
    ticks: list[float]

    @classmethod
    def of(cls, robot: Robot, gait: str, share: float) -> Steady:
        """The first tick in a swing, after a while, of which ``share`` or less remains."""
        controller, ticks, before = Controller(robot, gaits=(gait,)), list[float](), 0.0
        speed = SPEEDS[gait] * float(np.sqrt(gravity_of(robot.model) * robot.length))
        command, planner = Command(gait=gait, speed=speed), controller.planner
        q, v, active = robot.reference, np.zeros(robot.nv), np.ones(len(robot.contacts), dtype=bool)
        for k in count():
            begun = time.thread_time()
            controller.step(k * TICK, q, v, active, command)
            ticks.append(time.thread_time() - begun)
            clock = planner.clock
            swinging = len(planner.horizon()[0].pattern.contacts[0]) < len(clock.contacts)
            left = clock.remaining / clock.whole if swinging else 0.0
            if k * TICK > TIMED and left <= share < before:
                break
            assert controller.plans.motion is not None
            sample, before = controller.plans.motion.sample((k + 1) * TICK), left
            q, v, active = sample.q, sample.v, sample.active
        assert planner._last is not None
        horizon, iterate = planner._last
        begin = HorizonMotion(horizon, iterate["x"], 0.0).sample(0.0)
        optimum, _ = planner.settings.solver.solve(horizon, iterate, STEPS)
        return cls(
            controller=controller,
            horizon=horizon,
            iterate=optimum,
            q=begin.q,
            v=begin.v,
            ticks=ticks[round(STEADY / TICK) :],
        )

    def starts(self, number: int) -> list[np.ndarray]:
        """Starts (nq + nv,) near that of the plan, whose standing contacts stand still."""
        units, generator = self.horizon.units, np.random.default_rng(0)
        contacts, result = self.horizon.pattern.contacts[0], []
        for _ in range(number):
            pushed = self.v.copy()
            pushed[:3] += PUSH * units.length / units.time * generator.standard_normal(3)
            pushed[3:6] += SPIN / units.time * generator.standard_normal(3)
            result.append(np.concatenate([self.q, self.controller.planner._held(self.q, pushed, contacts)]))
        return result

    def seconds(self, start: np.ndarray) -> tuple[float, _engine.StepReport]:
        """Seconds of one step from the optimum to another start, and its report."""
        horizon, settings = self.horizon, self.controller.planner.settings.solver
        nq = self.controller.robot.nq
        state = horizon.layout.coordinates.node_from_pinocchio(start[:nq], start[nq:])
        state[:4] *= 1.0 if state[:4] @ self.iterate["x"][:4] >= 0 else -1.0
        horizon.set_start(state)
        x, node = self.iterate["x"].copy(), horizon.layout.node(0)
        x[node] = horizon.lower_x[node]
        iterate: _engine.Iterate = {**self.iterate, "x": x}
        begun = time.thread_time()
        _, reports = horizon.solver.steps(
            iterate, *horizon.bounds, horizon.compliance, settings.barrier, settings.most_barrier
        )
        return time.thread_time() - begun, reports[0]


@dataclass(frozen=True)
class Shooting:
    """The horizon of a tick as a request for Crocoddyl."""

    steady: Steady

    @cached_property
    def units(self) -> Units:
        """Scales of the robot."""
        return self.steady.horizon.units

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.steady.controller.robot

    @cached_property
    def _feet(self) -> list[Contact]:
        return [self.robot.contact(name) for name in self.steady.controller.clock.contacts]

    def request(self, name: str) -> dict[str, Any]:
        """With knots of 10 ms, or as many as the horizon has intervals."""
        return {
            "name": name,
            "model": _joints(self.robot.model),
            "mass_matrix": _mass_matrix(self.robot.model, self.steady.q).tolist(),
            "feet": [_foot(self.robot.model, foot) for foot in self._feet],
            "friction": self.steady.controller.settings.friction,
            "weights": self._weights(),
            "start": np.concatenate([self.steady.q, self.steady.v]).tolist(),
            "knots": list(self._knots(name)),
        }

    def _weights(self) -> dict[str, Any]:
        """Twice those of the horizon: costs of Crocoddyl are halves of squares."""
        units, w, nj = self.units, self.steady.controller.planner.settings.weights, self.robot.nv - 6
        length, rate = units.length**2, (units.length / units.time) ** 2
        position = [0.0, 0.0, w.height / length, w.tilt, w.tilt, w.heading, *[w.joints] * nj]
        velocity = [w.velocity / rate, w.velocity / rate, w.rise / rate, *[w.spin * units.time**2] * 3]
        state = [*position, *velocity, *[w.rates * units.time**2] * nj]
        return {
            "state": (2 * np.array(state)).tolist(),
            "control": 2 * w.torque / units.torque**2,
            "foot": 2 * w.feet / length,
            "sole": 2 * w.soles,
            "cone": 2 * CONE / units.force**2,
            "landing": 2 * LANDING * units.time / length,
            "touchdown": 2 * TOUCHDOWN * units.time / rate,
        }

    def _knots(self, name: str) -> Iterator[dict[str, Any]]:
        horizon = self.steady.horizon
        modes = zip(horizon.pattern.contacts, horizon.durations, horizon.pattern.intervals, strict=True)
        standing, begin, before, step = set[int](), 0.0, None, KNOT
        for contacts, duration, intervals in modes:
            standing = {self._feet.index(self.robot.contact(name)) for name in contacts}
            number = intervals if name == COARSE else max(1, round(duration / KNOT))
            step = float(duration) / number
            landed = set[int]() if before is None else standing - before
            for k in range(number):
                yield self._knot(begin + k * step, step, standing, landed if k == 0 else set())
            begin, before = begin + float(duration), standing
        yield self._knot(begin, step, standing, set())

    def _knot(self, at: float, step: float, standing: set[int], landed: set[int]) -> dict[str, Any]:
        layout, own = reference_layout(self.robot), self._reference.rows(np.array([at]))[0]
        turn = pin.Quaternion(own[layout.quaternion]).toRotationMatrix()
        state = [
            *(own[layout.position], own[layout.quaternion], own[layout.posture]),
            *(turn.T @ own[layout.velocity], turn.T @ own[layout.spin], np.zeros(self.robot.nv - 6)),
        ]
        feet = [own[layout.foot(self.robot.contacts.index(foot))] for foot in self._feet]
        return {
            "step": step,
            "standing": sorted(standing),
            "landed": sorted(landed),
            "state": np.concatenate(state).tolist(),
            "places": [foot[:3].tolist() for foot in feet],
            "factors": [foot[3:].tolist() for foot in feet],
        }

    @cached_property
    def _reference(self) -> Reference:
        controller = self.steady.controller
        return controller._reference_maker()(controller.planner.clock, self.steady.q)


def _joints(model: pin.Model) -> list[dict[str, Any]]:
    """What a model is made of, as plain numbers."""
    joints = zip(model.joints, model.names, model.parents, model.jointPlacements, model.inertias, strict=True)
    return [
        {
            "kind": joint.shortname(),
            "axis": joint.extract().axis.tolist() if "Unaligned" in joint.shortname() else None,
            "name": name,
            "parent": int(parent),
            "place": place.homogeneous.tolist(),
            "mass": float(inertia.mass),
            "lever": inertia.lever.tolist(),
            "inertia": inertia.inertia.tolist(),
        }
        for joint, name, parent, place, inertia in list(joints)[1:]
    ]


def _foot(model: pin.Model, contact: Contact) -> dict[str, Any]:
    frame = model.frames[model.getFrameId(contact.frame)]
    return {
        "frame": contact.frame,
        "kind": contact.kind,
        "box": [2 * contact.half_length, 2 * contact.half_width],
        "joint": int(frame.parentJoint),
        "place": frame.placement.homogeneous.tolist(),
    }


def _mass_matrix(model: pin.Model, q: np.ndarray) -> np.ndarray:
    upper = np.triu(pin.crba(model, model.createData(), q))
    return np.asarray(upper + np.triu(upper, 1).T)


class Comparison:
    """Both halves on the horizon of one tick."""

    def __init__(self, steady: Steady, peer: Half) -> None:
        self.steady, self.peer = steady, peer
        shooting = Shooting(steady)
        self.found = {name: peer.ask(do="build", **shooting.request(name)) for name in (FINE, COARSE)}
        self.own: list[float] = []
        self.full = 0
        self.theirs: dict[str, dict[str, list[float]]] = {name: {} for name in self.found}

    def measure(self, rounds: int) -> None:
        """In turns, each over the same starts; the first of a turn is not counted."""
        starts = self.steady.starts(rounds * (TURN + 1))
        for first in range(0, len(starts), TURN + 1):
            turn = starts[first : first + TURN + 1]
            steps = [self.steady.seconds(start) for start in turn][1:]
            self.own += [seconds for seconds, _ in steps]
            self.full += sum(report["primal_step"] == 1.0 for _, report in steps)
            for name, times in self.theirs.items():
                answer = self.peer.ask(do="iterate", name=name, starts=[start.tolist() for start in turn])
                for part, values in answer.items():
                    times.setdefault(part, []).extend(values[1:])

    def cells(self) -> list[str]:
        """Of the table."""
        horizon, ticks = self.steady.horizon, self.steady.ticks
        step = median(self.own)
        cells = [f"{horizon.durations.sum():.2f}", f"{sum(horizon.pattern.intervals)}"]
        cells += [f"{1e3 * np.percentile(ticks, part):.1f}" for part in (50, 99)]
        cells.append(f"{1e3 * step:.2f}")
        for name, times in self.theirs.items():
            pairs = zip(times["whole"], times["steps"], strict=True)
            whole = median([seconds for seconds, part in pairs if part == 1.0])
            cells += [str(self.found[name]["knots"]), f"{1e3 * whole:.2f}", f"{step / whole:.2f}"]
        return cells

    def notes(self) -> Iterator[str]:
        """What Crocoddyl's solutions are, and parts of its iterations."""
        yield f"ours: {self.full} of {len(self.own)} steps are full; {_spread(self.own)}"
        for name, times in self.theirs.items():
            found = self.found[name]
            yield f"{name}: " + ", ".join(f"{key} {value}" for key, value in found.items())
            full = sum(step == 1.0 for step in times["steps"])
            parts = (
                f"{part} {_spread(times[part])}" for part in ("whole", "derivatives", "backward", "forward")
            )
            yield f"{name}: {full} of {len(times['steps'])} steps are full; {', '.join(parts)}"


def _spread(seconds: Sequence[float]) -> str:
    low, middle, high = 1e3 * np.percentile(seconds, [25, 50, 75])
    return f"{middle:.2f} ms ({low:.2f} to {high:.2f})"


TITLES = ("robot", "gait", "horizon, s", "intervals", "tick, ms", "99 %, ms", "step, ms")
OF_FDDP = ("knots of 10 ms", "FDDP, ms", "step / FDDP", "as many knots", "FDDP, ms", "step / FDDP")


@click.command("fddp")
@click.option("--robots", "names", default=",".join(GAITS), metavar="A,B", show_default=True)
@click.option("--rounds", default=30, show_default=True, help=f"Turns of {TURN} starts of each half.")
@click.option("--share", default=0.5, show_default=True, help="Part of the present mode that remains.")
@click.option("--peer", default=PEER, show_default=True, help="Command of Crocoddyl's half.")
def fddp(names: str, rounds: int, share: float, peer: str) -> None:
    """A step of the horizon over one iteration of Crocoddyl's FDDP on the same horizon, CPU times."""
    head(*TITLES, *OF_FDDP)
    other = Half("Crocoddyl's half", peer)
    for name in names.split(","):
        compared = Comparison(Steady.of(robots.load(name), GAITS[name], share), other)
        compared.measure(rounds)
        row(name, GAITS[name], *compared.cells())
        for note in compared.notes():
            click.echo(f"{name}: {note}", err=True)
    other.close()


if __name__ == "__main__":
    fddp()

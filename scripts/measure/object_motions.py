"""Arms that push and lift a block: contacts between two bodies of one model (docs/discovery.md, Objects).

A prototype beside the library, whose contacts are with surroundings that do not move. Arms and block are
one model; implicit midpoints on the manifold of its joints; rows from `rigid_body.fused`. A finger is a
point. Where it touches, f acts on it and -f on the block, at the same place, and its velocity relative to
the face is zero at nodes. The table pushes at four corners. Its friction is Coulomb's where the schedule
says that the block slides, and mu v / sqrt(v^2 + CREEP^2) times the load without a schedule.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
from scipy import sparse

import trajopt
from scripts.measure.shared import NOISE
from trajopt.dynamics import rigid_body
from trajopt_library import robots

SIZE, MASS = 0.2, 0.5  # of the cube, m and kg
WEIGHT = 9.81 * MASS
SPEED = (9.81 * SIZE) ** 0.5  # unit of velocity, m/s
FINGER_FRICTION, TABLE_FRICTION = 0.5, 0.3
CREEP = 0.02  # m/s, below which friction of the table is smoothed
HELD_AT = 0.03  # m above the block's centre: lower, it would be no pendulum and its turn could not be steered
START_GAP = 0.08  # m from a finger to its face
FINGER = 0.15  # m from the frame of a tool to the finger's end
REACH, TOTAL = 0.6, 1.4  # s
MOST_ITERATIONS = 300
CORNERS = [np.array([x, y, -1]) * SIZE / 2 for x in (-1, 1) for y in (-1, 1)]
# Axis of a tool that points out of it.
OUT = {"z1": (1, 0, 0), "panda": (0, 0, 1), "xarm7": (0, 0, 1)}
# Where an arm starts, if not in its reference: folded, so that it reaches 0.38 m farther.
FOLDED = {"z1": np.array([0, 1.3, -1.4, 0.9, 0, 0])}


@dataclass(frozen=True)
class Scene:
    """Arms at the sides of a block: -1 is where x is negative."""

    arm: str
    sides: tuple[int, ...]
    goal: tuple[float, float, float]
    lifted: bool

    @cached_property
    def built(self) -> tuple[pin.Model, np.ndarray]:
        """The model of arms and block, and where it starts."""
        robot, tool = trajopt.robot(self.arm), robots.tool_frame(self.arm)
        data, model, start = robot.model.createData(), pin.Model(), []
        frame = robot.model.frames[robot.model.getFrameId(tool)]
        end = frame.placement * pin.SE3(np.eye(3), FINGER * np.array(OUT[self.arm], float))
        posture = FOLDED.get(self.arm, robot.reference)
        pin.forwardKinematics(robot.model, data, posture)
        reached = (data.oMi[frame.parentJoint] * end).translation
        for index, side in enumerate(self.sides):
            part = robot.model.copy()
            part.addFrame(pin.Frame("finger", frame.parentJoint, 0, end, pin.OP_FRAME))
            for j in range(1, part.njoints):
                part.names[j] = f"{index}_{part.names[j]}"
            for k, each in enumerate(part.frames):
                each.name = f"{index}_{each.name if each.name == 'finger' else k}"
            turned = pin.utils.rotate("z", 0.0 if side < 0 else np.pi)
            wanted = np.array([side * (SIZE / 2 + START_GAP), 0, SIZE / 2 + HELD_AT])
            model = pin.appendModel(model, part, 0, pin.SE3(turned, wanted - turned @ reached))
            start.append(posture)
        block = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "block")
        model.appendBodyToJoint(block, pin.Inertia.FromBox(MASS, SIZE, SIZE, SIZE), pin.SE3.Identity())
        model.addFrame(pin.Frame("block", block, 0, pin.SE3.Identity(), pin.OP_FRAME))
        return model, np.concatenate([*start, [0, 0, SIZE / 2, 0, 0, 0, 1]])

    @property
    def model(self) -> pin.Model:
        """Of arms and block."""
        return self.built[0]

    @property
    def touches(self) -> list[np.ndarray]:
        """Of each finger, in the block's axes."""
        return [np.array([side * SIZE / 2, 0, HELD_AT]) for side in self.sides]

    @property
    def frames(self) -> list[str]:
        """Fingers and block."""
        return [*(f"{i}_finger" for i in range(len(self.sides))), "block"]

    def stage(self, step: float) -> tuple[ca.Function, dict[str, slice]]:
        """Cost and rows of an interval, and where rows of each kind are.

        (state and next state, given) -> (cost, rows); given are the slack, whether friction of the table is
        smoothed, and whether the block slides along x.
        """
        m, n = self.model, len(self.sides)
        q, v, f, c = (ca.SX.sym(k, s) for k, s in zip("qvfc", (m.nq, m.nv, 3 * n, 4), strict=True))
        q1, v1, unused = ca.SX.sym("q1", m.nq), ca.SX.sym("v1", m.nv), ca.SX.sym("f1", 3 * n + 4)
        slack, smooth, slides = ca.vertsplit(given := ca.SX.sym("given", 3))
        move, middle = rigid_body.integrate(m), (v + v1) / 2
        a, half = (v1 - v) / step, move(q, step / 2 * middle)
        fused = rigid_body.fused(m, self.frames, [3] * n + [6])
        at, after = fused(half, middle, a, 0), fused(q1, v1, 0, 0)
        parts: dict[str, list] = {
            k: [] for k in ("step", "block", "torque", "cone", "place", "slip", "height")
        }
        parts |= {"near": [], "still": [], "low": []}
        turn, origin = ca.reshape(at[1][:, n], 3, 3), at[2][:, n]
        wrench, forces = ca.SX.zeros(6), []
        for i, (side, touch) in enumerate(zip(self.sides, self.touches, strict=True)):
            force = f[3 * i : 3 * i + 3] * WEIGHT
            forces.append(force)
            wrench -= ca.vertcat(force, ca.cross(at[2][:, i] - origin, force))
            local = ca.mtimes(turn.T, f[3 * i : 3 * i + 3])
            push, tangent = side * local[0], local[1:]
            limit = FINGER_FRICTION / 2**0.5 * push
            parts["cone"] += [push, limit - tangent, limit + tangent]
            for when, sort in ((at, "near"), (after, "place")):
                axes, arm = ca.reshape(when[1][:, n], 3, 3).T, when[2][:, i] - when[2][:, n]
                place = ca.mtimes(axes, arm)
                slip = when[3][:3, i] - when[3][:3, n] - ca.cross(when[3][3:, n], arm)
                slip = ca.mtimes(axes, slip) / SPEED
                if sort == "place":
                    parts["place"] += [(place - touch) / SIZE * ca.DM([side, 1, 1])]
                    parts["slip"] += [slip]
                else:
                    beside = ca.fmax(ca.fabs(place[1:]) - SIZE / 2, 0) / SIZE
                    gap = (side * place[0] - SIZE / 2) / SIZE
                    parts["near"] += [push * (gap + ca.sumsqr(beside)) / slack]
                    parts["still"] += [push * slip / slack]
        for i, corner in enumerate(CORNERS):
            arm = ca.mtimes(turn, ca.DM(corner))
            slide = (at[3][:3, n] + ca.cross(at[3][3:, n], arm))[:2]
            load = c[i] * WEIGHT
            along = smooth * slide / ca.sqrt(ca.sumsqr(slide) + CREEP**2) + slides * ca.DM([1, 0])
            force = ca.vertcat(-TABLE_FRICTION * load * along, load)
            wrench += ca.vertcat(force, ca.cross(arm, force))
            parts["low"] += [c[i] * (origin[2] + arm[2]) / SIZE / slack]
            parts["height"] += [
                (after[2][2, n] + ca.mtimes(ca.reshape(after[1][:, n], 3, 3), ca.DM(corner))[2]) / SIZE
            ]
        tau = fused(half, middle, a, ca.vertcat(*forces, wrench))[0]
        used = tau[:-6] / ca.DM(m.effortLimit[:-6])
        parts["step"] = [q1 - move(q, step * middle)]
        parts["block"] = [tau[-6:-3] / WEIGHT, tau[-3:] / WEIGHT / SIZE]
        parts["torque"] = [used]
        cost = step * (
            ca.sumsqr(used) + 1e-2 * ca.sumsqr(f) + 1e-2 * ca.sumsqr(c) + 1e-2 * ca.sumsqr(middle[:-6])
        )
        rows, where, at_row = [], {}, 0
        for key, entries in parts.items():
            rows.append(ca.vertcat(*entries))
            where[key] = slice(at_row, at_row := at_row + rows[-1].numel())
        state, following = ca.vertcat(q, v, f, c), ca.vertcat(q1, v1, unused)
        both = ca.cse([cost, ca.vertcat(*rows)])
        return ca.Function("stage", [ca.vertcat(state, following), given], both), where


def solver(stage: ca.Function, size: int, count: int) -> ca.Function:
    """IPOPT for a chain of stages, with derivatives of one stage mapped and scattered."""
    z, s = ca.SX.sym("z", 2 * size), ca.SX.sym("s", 3)
    cost, rows = stage(z, s)
    lam, sigma = ca.SX.sym("l", rows.numel()), ca.SX.sym("o")
    jacobian = ca.jacobian(rows, z)
    hessian = ca.triu(ca.hessian(sigma * cost + ca.dot(lam, rows), z)[0])
    slopes = ca.Function("slopes", [z, s], [ca.gradient(cost, z), jacobian.nz[:]], {"cse": True})
    curves = ca.Function("curves", [z, s, sigma, lam], [hessian.nz[:]], {"cse": True})
    x, p, total = ca.MX.sym("x", size * (count + 1)), ca.MX.sym("p", 3, count), size * (count + 1)
    o, m = ca.MX.sym("o"), ca.MX.sym("l", rows.numel() * count)
    nodes = ca.reshape(x, size, count + 1)
    pairs = ca.vertcat(nodes[:, :-1], nodes[:, 1:])
    values, first = stage.map(count)(pairs, p), slopes.map(count)(pairs, p)
    second = curves.map(count)(pairs, p, ca.repmat(o, 1, count), ca.reshape(m, rows.numel(), count))

    def scattered(entries: ca.MX, pattern: ca.Sparsity, rise: int, shape: tuple[int, int]) -> ca.MX:
        own = np.array(pattern.row()), np.array(pattern.get_col())
        down = np.concatenate([own[0] + rise * k for k in range(count)])
        right = np.concatenate([own[1] + size * k for k in range(count)])
        key, place = np.unique(right.astype(np.int64) * shape[0] + down, return_inverse=True)
        union = sparse.csc_matrix((np.ones(len(key)), (key % shape[0], key // shape[0])), shape=shape)
        adding = sparse.csc_matrix((np.ones(len(place)), (place, np.arange(len(place)))))
        target = ca.Sparsity(*shape, union.indptr.tolist(), union.indices.tolist())
        return ca.MX(target, ca.mtimes(ca.DM(adding), ca.vec(entries)))

    f, g = ca.sum2(values[0]), ca.vec(values[1])
    none = ca.MX.zeros(size, 1)
    gradient = ca.vec(ca.horzcat(first[0][:size, :], none) + ca.horzcat(none, first[0][size:, :]))
    jac = scattered(first[1], jacobian.sparsity(), rows.numel(), (rows.numel() * count, total))
    hess = scattered(second, hessian.sparsity(), size, (total, total))
    options: dict[str, Any] = {
        "grad_f": ca.Function("grad_f", [x, p], [f, gradient]),
        "jac_g": ca.Function("jac_g", [x, p], [g, jac]),
        "hess_lag": ca.Function("hess_lag", [x, p, o, m], [hess]),
        "print_time": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": MOST_ITERATIONS},
    }
    problem: dict[str, Any] = {"x": x, "p": p, "f": f, "g": g}
    return ca.nlpsol("solver", "ipopt", problem, options)


@dataclass(frozen=True)
class Plan:
    """States at nodes (count + 1, nq + nv + forces of fingers and corners), and what the solver said."""

    scene: Scene
    step: float
    touched: int
    states: np.ndarray
    solved: bool
    iterations: int
    status: str


class Task:
    """The NLP of a scene, with a touch at a given node or with complementarity."""

    def __init__(self, scene: Scene, count: int) -> None:
        self.scene, self.count, self.step = scene, count, TOTAL / count
        stage, self.where = scene.stage(self.step)
        self.size, self.rows = stage.size1_in(0) // 2, stage.size1_out(1)
        self.solver = solver(stage, self.size, count)
        self.touched = round(REACH / self.step)
        self.variables = self.size * (count + 1)

    def bounds(self, relaxed: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of states and rows."""
        scene, m, where = self.scene, self.scene.model, self.where
        nq, nv = m.nq, m.nv
        low, high = np.full((2, self.count + 1, self.size), np.inf)
        low *= -1
        low[:, : nq - 7], high[:, : nq - 7] = m.lowerPositionLimit[:-7], m.upperPositionLimit[:-7]
        high[:, nq : nq + nv - 6] = m.velocityLimit[:-6]
        low[:, nq : nq + nv - 6] = -high[:, nq : nq + nv - 6]
        low[:, -4:] = 0
        low[0, :nq] = high[0, :nq] = scene.built[1]
        low[-1, nq - 7 : nq - 1] = high[-1, nq - 7 : nq - 1] = [*scene.goal, 0, 0, 0]
        for end in (0, -1):
            low[end, nq : nq + nv] = high[end, nq : nq + nv] = 0
        low[-1, nq + nv :] = high[-1, nq + nv :] = 0
        below, above = np.full((2, self.count, self.rows), np.inf)
        below *= -1
        for key in ("step", "block"):
            below[:, where[key]] = above[:, where[key]] = 0
        below[:, where["torque"]], above[:, where["torque"]] = -1, 1
        for key in ("cone", "height"):
            below[:, where[key]] = 0
        gaps = slice(where["place"].start, where["place"].stop, 3)
        below[:, gaps] = 0
        if relaxed:
            above[:, where["near"]] = above[:, where["low"]] = above[:, where["still"]] = 1
            below[:, where["still"]] = -1
            if not scene.lifted:  # smoothed friction ends no motion within a finite time
                high[-1, nq + nv - 6] = CREEP
            return low, high, below, above
        k = self.touched
        below[k - 1, where["place"]] = above[k - 1, where["place"]] = 0
        below[k:, gaps], below[:k, where["cone"]] = -np.inf, -np.inf
        below[k - 1 : -1, where["slip"]] = above[k - 1 : -1, where["slip"]] = 0
        low[:k, nq + nv : -4] = high[:k, nq + nv : -4] = 0
        table, velocity = k if scene.lifted else self.count, slice(nq + nv - 6, nq + nv)
        below[:table, where["height"]] = -np.inf
        low[1 : table + 1, velocity] = high[1 : table + 1, velocity] = 0
        unmoved = where["block"].start + np.array([0, 1, 5])
        below[:k, unmoved], above[:k, unmoved] = -np.inf, np.inf
        if scene.lifted:
            high[k:, -4:] = 0
        else:  # sliding straight: friction turns by the loads that tilt, so that yaw follows from roll and y
            below[:, unmoved[2]], above[:, unmoved[2]] = -np.inf, np.inf
            high[k + 1 : -1, velocity.start] = np.inf
            low[-1, nq - 6 : nq - 1], high[-1, nq - 6 : nq - 1] = -np.inf, np.inf
        return low, high, below, above

    def still(self, seed: int) -> np.ndarray:
        """Arms that stand still, a block on a straight path; a seed other than 0 adds noise."""
        scene, m = self.scene, self.scene.model
        states = np.tile(np.concatenate([scene.built[1], np.zeros(self.size - m.nq)]), (self.count + 1, 1))
        part = np.linspace(0, 1, self.count + 1)[:, None]
        begin = scene.built[1][-7:-4]
        states[:, m.nq - 7 : m.nq - 4] = begin + part * (np.array(scene.goal) - begin)
        states[:, -4:] = 0.25
        if seed:
            noise = NOISE * np.random.default_rng(seed).standard_normal(states.shape)
            noise[:, m.nq - 7 : m.nq - 4] *= SIZE
            states = states + noise
        return states

    def solve(self, start: np.ndarray, slack: float | None) -> Plan:
        """Solve with a given touch, or without at a slack."""
        low, high, below, above = self.bounds(slack is not None)
        given = np.zeros((3, self.count))
        given[0], given[1] = slack or 1.0, slack is not None
        given[2, self.touched :] = slack is None
        result = self.solver(
            x0=start.ravel(), p=given, lbx=low.ravel(), ubx=high.ravel(), lbg=below.ravel(), ubg=above.ravel()
        )
        stats = self.solver.stats()
        states = np.array(result["x"]).reshape(self.count + 1, self.size)
        status = stats["return_status"]
        return Plan(
            self.scene, self.step, self.touched, states, stats["success"], stats["iter_count"], status
        )

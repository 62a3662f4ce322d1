"""Arms that push and lift a block, contacts between two bodies of one model (docs/discovery.md, Objects).

A prototype beside the library, whose contacts are with surroundings that do not move: arms and block are one
model, by implicit midpoints on its joints' manifold, with `rigid_body.fused`. A finger is a point that touches a
face of the block: f acts on the finger and -f on the block, at the same point. Where it touches, its velocity
relative to the face is zero at nodes. The table pushes at four corners, with Coulomb's friction of
v / sqrt(v^2 + CREEP^2) where they slide.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import click
import numpy as np
import pinocchio as pin
from scipy import sparse

import trajopt
from scripts.measure.shared import NOISE, head, median, row
from trajopt.discovery.relaxation import SLACKS
from trajopt.discovery.modes import LOADED
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
STIFFNESS = 900.0  # of the feedback in the check, 1/s^2
FINE = 8  # places in an interval where the check looks
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
        """Cost and rows of an interval, (state and next state, (slack, smooth, slides)) -> (cost, rows), and where rows are."""
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
    slopes = ca.Function(
        "slopes", [z, s], [ca.gradient(cost, z), ca.vertcat(*jacobian.nonzeros())], {"cse": True}
    )
    curves = ca.Function("curves", [z, s, sigma, lam], [ca.vertcat(*hessian.nonzeros())], {"cse": True})
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
    options = {
        "grad_f": ca.Function("grad_f", [x, p], [f, gradient]),
        "jac_g": ca.Function("jac_g", [x, p], [g, jac]),
        "hess_lag": ca.Function("hess_lag", [x, p, o, m], [hess]),
        "print_time": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": MOST_ITERATIONS},
    }
    return ca.nlpsol("solver", "ipopt", {"x": x, "p": p, "f": f, "g": g}, options)


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
        nq, nv, n = m.nq, m.nv, len(scene.sides)
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
        else:  # as on a rail: in a straight slide the rows of y, roll and yaw say the same twice
            below[:, unmoved[1:]], above[:, unmoved[1:]] = -np.inf, np.inf
            high[k + 1 : -1, velocity.start] = np.inf
            low[-1, nq - 6 : nq - 1], high[-1, nq - 6 : nq - 1] = -np.inf, np.inf
        return low, high, below, above

    def still(self, seed: int) -> np.ndarray:
        """Arms that stand still while the block moves straight to its goal; a seed other than 0 adds noise."""
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
        given[:2] = [[slack or 1.0], [slack is not None]]
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


class Judge:
    """Numeric Pinocchio on a plan, between its nodes too: accelerations and forces are constant in an interval."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.scene, self.model = plan, plan.scene, plan.scene.model
        self.data = self.model.createData()
        self.ids = [self.model.getFrameId(name) for name in self.scene.frames]

    def at(self, k: int, part: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration at a part of an interval."""
        m, h = self.model, self.plan.step
        q, v = np.split(self.plan.states[k, : m.nq + m.nv], [m.nq])
        a = (self.plan.states[k + 1, m.nq : m.nq + m.nv] - v) / h
        return pin.integrate(m, q, part * h * v + (part * h) ** 2 / 2 * a), v + part * h * a, a

    def middle(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The collocation point, on the straight way of the mean velocity."""
        _, v, a = self.at(k, 0.5)
        q = self.plan.states[k, : self.model.nq]
        return pin.integrate(self.model, q, self.plan.step / 2 * v), v, a

    def forces(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """On fingers (n, 3) and corners (4, 3), world axes, N."""
        f = WEIGHT * self.plan.states[k, self.model.nq + self.model.nv :]
        drag = -TABLE_FRICTION if k >= self.plan.touched and not self.scene.lifted else 0.0
        return f[:-4].reshape(-1, 3), np.outer(f[-4:], [drag, 0, 1])

    def wrench(self, k: int, q: np.ndarray, fingers: bool = True) -> np.ndarray:
        """On the block at its centre (6,), world axes; forces act at fingers and corners of configuration q."""
        touching, table = self.forces(k)
        pin.framesForwardKinematics(self.model, self.data, q)
        *ends, block = (self.data.oMf[i] for i in self.ids)
        arms = [
            (end.translation - block.translation, -f)
            for end, f in zip(ends, touching, strict=True)
            if fingers
        ]
        arms += [(block.rotation @ c, f) for c, f in zip(CORNERS, table, strict=True)]
        return np.concatenate([sum(f for _, f in arms), sum(np.cross(r, f) for r, f in arms)])

    def jacobians(self, q: np.ndarray) -> list[np.ndarray]:
        """Of fingers and block (6, nv), world-aligned."""
        return [
            pin.computeFrameJacobian(self.model, self.data, q, i, pin.LOCAL_WORLD_ALIGNED) for i in self.ids
        ]

    def mass(self, q: np.ndarray) -> np.ndarray:
        """Of all joints (nv, nv)."""
        upper = np.triu(pin.crba(self.model, self.data, q))
        return upper + np.triu(upper, 1).T

    def residual(self, k: int, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, float]:
        """Torques over their limits, and the block's worst row over its weight (times its size)."""
        *ends, block = self.jacobians(q)
        tau = pin.rnea(self.model, self.data, q, v, a) - block.T @ self.wrench(k, q)
        tau -= sum(end[:3].T @ f for end, f in zip(ends, self.forces(k)[0], strict=True))
        return tau[:-6] / self.model.effortLimit[:-6], abs(tau[-6:] / WEIGHT / np.repeat([1, SIZE], 3)).max()

    def touching(self, q: np.ndarray) -> list[np.ndarray]:
        """Where fingers are, in the block's axes, from where they should touch."""
        pin.framesForwardKinematics(self.model, self.data, q)
        *ends, block = (self.data.oMf[i] for i in self.ids)
        return [block.actInv(e.translation) - t for e, t in zip(ends, self.scene.touches, strict=True)]

    def figures(self) -> dict[str, float]:
        """The worst of every kind over the plan."""
        count, k0 = len(self.plan.states) - 1, self.plan.touched
        worst = dict.fromkeys(("block", "between", "torque", "drift"), 0.0) | {"friction": np.inf}
        for k in range(count):
            used, block = self.residual(k, *self.middle(k))
            worst["torque"] = max(worst["torque"], abs(used).max())
            worst["block"] = max(worst["block"], block)
            for part in np.linspace(0, 1, FINE + 1):
                q, v, a = self.at(k, part)
                worst["between"] = max(worst["between"], self.residual(k, q, v, a)[1])
                if k < k0:
                    continue
                worst["drift"] = max(worst["drift"], *(float(np.linalg.norm(d)) for d in self.touching(q)))
                turn = self.data.oMf[self.ids[-1]].rotation.T
                for side, f in zip(self.scene.sides, self.forces(k)[0] / WEIGHT, strict=True):
                    push, *tangent = turn @ f * [side, 1, 1]
                    worst["friction"] = min(worst["friction"], FINGER_FRICTION * push - np.hypot(*tangent))
        return worst | {
            "alone": self.block_alone(),
            "open loop": self.simulated(0),
            "tracked": self.simulated(STIFFNESS),
        }

    def block_alone(self) -> float:
        """Distance in m from the plan at the end, of the block alone under the planned forces, by Runge-Kutta."""
        m, h, count = self.model, self.plan.step / FINE, len(self.plan.states) - 1
        block = m.joints[m.njoints - 1].idx_q
        inertia, y = MASS * SIZE**2 / 6, np.zeros(12)  # position, velocity, turn and its rate
        y[:3] = self.plan.states[0, block : block + 3]

        def rate(y: np.ndarray, k: int, part: float) -> np.ndarray:
            q = self.at(k, part)[0]
            q[block:] = [*y[:3], *pin.Quaternion(pin.exp3(y[6:9])).coeffs()]
            wrench = self.wrench(k, q)
            turning = pin.Jlog3(pin.exp3(y[6:9])) @ pin.exp3(y[6:9]).T @ y[9:]
            return np.concatenate([y[3:6], wrench[:3] / MASS - [0, 0, 9.81], turning, wrench[3:] / inertia])

        for k in range(count):
            for i in range(FINE):
                y = runge_kutta(lambda y, part, k=k: rate(y, k, part), y, i / FINE, h, 1 / FINE)
        return float(np.linalg.norm(y[:3] - self.plan.states[-1, block : block + 3]))

    def simulated(self, stiffness: float) -> float:
        """The same of arms and block under planned torques, where forces follow from the motion.

        With feedback of joints' errors, of a ``stiffness`` (1/s^2) times the mass matrix, damped critically.
        """
        m, d, h = self.model, self.data, self.plan.step / FINE
        q, v = np.split(self.plan.states[0, : m.nq + m.nv].copy(), [m.nq])

        def acceleration(k: int, tau: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            *ends, block = self.jacobians(q)
            bias = pin.rnea(m, d, q, v, 0 * v) - block.T @ self.wrench(k, q, fingers=False)
            mass = self.mass(q)
            if k < self.plan.touched:
                return np.linalg.solve(mass, np.pad(tau, (0, 6)) - bias)
            pin.forwardKinematics(m, d, q, v, 0 * v)
            pin.updateFramePlacements(m, d)
            base, rows, right = self.ids[-1], [], []
            speed = pin.getFrameVelocity(m, d, base, pin.LOCAL_WORLD_ALIGNED)
            drift = pin.getFrameClassicalAcceleration(m, d, base, pin.LOCAL_WORLD_ALIGNED)
            for i, end in zip(self.ids[:-1], ends, strict=True):
                r = d.oMf[i].translation - d.oMf[base].translation
                own = pin.getFrameClassicalAcceleration(m, d, i, pin.LOCAL_WORLD_ALIGNED).linear
                w = speed.angular
                rows.append(end[:3] - block[:3] + pin.skew(r) @ block[3:])
                right.append(drift.linear + np.cross(drift.angular, r) + np.cross(w, np.cross(w, r)) - own)
            pair = np.vstack(rows)
            zero = np.zeros((len(pair), len(pair)))
            system = np.block([[mass, -pair.T], [pair, zero]])
            return np.linalg.solve(system, np.concatenate([np.pad(tau, (0, 6)) - bias, *right]))[: m.nv]

        for k in range(len(self.plan.states) - 1):
            tau = self.residual(k, *self.middle(k))[0] * m.effortLimit[:-6]
            for i in range(FINE):

                def rate(
                    y: np.ndarray, part: float, k: int = k, tau: np.ndarray = tau, q: np.ndarray = q
                ) -> np.ndarray:
                    at, speed = pin.integrate(m, q, y[: m.nv]), y[m.nv :]
                    wanted, pace, _ = self.at(k, part)
                    error = stiffness * pin.difference(m, at, wanted) + 2 * stiffness**0.5 * (pace - speed)
                    feedback = (self.mass(at) @ error)[:-6]
                    return np.concatenate([speed, acceleration(k, tau + feedback, at, speed)])

                y = runge_kutta(rate, np.concatenate([np.zeros(m.nv), v]), i / FINE, h, 1 / FINE)
                q, v = pin.integrate(m, q, y[: m.nv]), y[m.nv :]
        block = m.joints[m.njoints - 1].idx_q
        return float(np.linalg.norm(q[block : block + 3] - self.plan.states[-1, block : block + 3]))


def runge_kutta(
    rate: Callable[[np.ndarray, float], np.ndarray], y: np.ndarray, part: float, h: float, step: float
) -> np.ndarray:
    """A step of the classical scheme; ``part`` of the interval goes on by ``step``."""
    first = rate(y, part)
    second = rate(y + h / 2 * first, part + step / 2)
    third = rate(y + h / 2 * second, part + step / 2)
    fourth = rate(y + h * third, part + step)
    return y + h / 6 * (first + 2 * second + 2 * third + fourth)


LIFT, PUSH = (
    {"sides": (-1, 1), "goal": (0, 0, 0.3), "lifted": True},
    {"sides": (-1,), "goal": (0.3, 0, 0.1), "lifted": False},
)
SCENES = {"lift": LIFT, "push": PUSH}
CASES = [
    (task, arm, count) for task in SCENES for arm in OUT for count in ((28, 56) if arm == "z1" else (28,))
]


def found(task: Task, seed: int) -> tuple[list[int], float | None, Plan]:
    """Iterations of the solves with complementarity, the least slack that was solved, the last motion."""
    start, iterations, reached = task.still(seed), [], None
    for slack in SLACKS:
        plan = task.solve(start, slack)
        iterations.append(plan.iterations)
        if not plan.solved:
            break
        start, reached, last = plan.states, slack, plan
    return iterations, reached, plan if reached is None else last


def first_touch(task: Task, plan: Plan) -> int | None:
    """The first interval in which all fingers bear load, None without one."""
    at = task.scene.model.nq + task.scene.model.nv
    loads = np.array([np.linalg.norm(f.reshape(-1, 3), axis=1) for f in plan.states[:-1, at:-4]])
    loaded = np.flatnonzero((loads > LOADED).all(axis=1))
    return int(loaded[0]) if len(loaded) else None


@click.command("objects")
@click.option("--only", default="", metavar="WORD", help="Tasks or arms with this in their name.")
@click.option(
    "--starts", default=3, show_default=True, help="Starts of each task; all but the first with noise."
)
def objects(only: str, starts: int) -> None:
    """A block that two arms lift or one arm pushes: with a given touch, and with complementarity."""
    chosen = [case for case in CASES if only in " ".join(map(str, case))]
    costs = ("task", "arm", "intervals", "variables", "solved", "iterations, median")
    rows = ("block's rows at points, over the weight", "between", "torque over limit", "finger's drift [m]")
    ends = (
        "friction, least margin over the weight",
        "block alone, end [m]",
        "open loop, end [m]",
        "with feedback [m]",
    )
    head(*costs, *rows, *ends)
    for name, arm, count in chosen:
        task = Task(Scene(arm, **SCENES[name]), count)
        plans = [task.solve(task.still(seed), None) for seed in range(starts)]
        good = [plan for plan in plans if plan.solved]
        judged = [Judge(plan).figures() for plan in good]
        worst = (
            [f"{(min if k == 'friction' else max)(j[k] for j in judged):.2g}" for k in judged[0]]
            if good
            else []
        )
        counts = median([plan.iterations for plan in good])
        row(name, arm, count, task.variables, f"{len(good)} of {starts}", f"{counts:.0f}", *worst)
    click.echo()
    head("task", "start", "iterations by slack", "least slack", "touch found [s]", "then with hard contacts")
    for name, arm, count in (case for case in chosen if case[1] == "z1" and case[2] == 28):
        task = Task(Scene(arm, **SCENES[name]), count)
        for seed in range(starts):
            iterations, reached, plan = found(task, seed)
            touch, hard = first_touch(task, plan) if reached else None, "no proposal"
            if touch:
                task.touched = touch
                plan = task.solve(plan.states, None)
                hard = f"{'solved' if plan.solved else plan.status}, {plan.iterations} iterations"
            shown = "" if touch is None else f"{touch * task.step:.2f}"
            row(name, seed, ", ".join(map(str, iterations)), reached or "none", shown, hard)

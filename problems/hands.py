"""Humanoids on feet and hands: they push off a wall, lean on a table to reach beyond it, climb with rails."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from trajopt.collision import BoxObstacle
from trajopt.errors import InputError
from trajopt.problem import Family, Problem, posture_guess, stepped_posture
from trajopt.robot import Posture, Robot, Units, biped_legs, contact_poses
from trajopt.schedule import Phase, Schedule
from trajopt.terms import Clearance, FramePose, TerminalRest, swing_clearance
from trajopt.terrain import PiecewiseTerrain, Surface, swing_path

from . import bipeds, common, pushing

REACH_ERROR = 1e-3
UP = np.array([0.0, 0.0, 1.0])
# A leaning robot's base is raised by this fraction of its height: straighter knees leave room for the ankles.
RAISED = 0.05
# Distance of the hands on the wall from the shoulders, over the farthest that they reach.
ARM_SHARE = 0.8
# Durations in units of sqrt(l / g).
PUSH, RECOVER, APPROACH, REACH, MOVE = 2.0, 5.0, 5.0, 5.0, 3.5
# Table height over base height; goal distance over that of the leaning shoulders; goal height over base
# height. The table is solid below a layer for the hands, m, since their contact is a ball.
TABLE, GOAL_AHEAD, GOAL_UP, LAYER = 1.0, 2.5, 1.2, 0.05
TABLE_SIDES, EDGE = (0.6, 1.2, 0.04), 0.1  # m; the hand is at distance EDGE from the edge
# Rise, run and rail height over base height; least run over sole length; start of steps; place of rails.
RISE, RUN, RAIL, SOLES, BEFORE_HEEL, AHEAD, APART = 0.35, 0.45, 0.75, 1.25, 0.1, 0.15, 1.3
# In the guess the base moves sideways by this fraction of the way to the standing foot. At the ends of a
# step's phases it has covered these fractions of the way forward and upward.
SWAY, FORWARD, UPWARD = 0.4, (0.0, 0.1, 0.35, 0.65, 0.95), (0.0, 0.0, 0.2, 0.35, 1.0)
CLEARANCE = 0.05
INTERVALS, OF_PHASE = 30, 20

Poses = Mapping[str, pin.SE3]


def at(position: np.ndarray) -> pin.SE3:
    """A pose whose rotation does not matter: of a hand, which is a point."""
    return pin.SE3(np.eye(3), np.array(position))


def soles(robot: Robot) -> Poses:
    """Poses of the feet in the reference posture."""
    poses = contact_poses(robot, robot.reference)
    return {name: poses[name] for name in biped_legs(robot)}


def middle_of(robot: Robot) -> np.ndarray:
    """The middle (3,) of the soles in the reference posture, m."""
    return np.mean([pose.translation for pose in soles(robot).values()], axis=0)


def shoulders(robot: Robot, q: np.ndarray) -> dict[str, np.ndarray]:
    """Where arms begin (3,), m, world, by the hand's name: the first joint that carries this hand alone."""
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, q)
    frames = {name: model.frames[model.getFrameId(robot.contact(name).frame)] for name in bipeds.hands(robot)}
    chains = {name: list(model.supports[frame.parentJoint]) for name, frame in frames.items()}
    shared = set.intersection(*map(set, chains.values()))
    first = {name: next(joint for joint in chain if joint not in shared) for name, chain in chains.items()}
    return {name: np.array(data.oMi[joint].translation) for name, joint in first.items()}


def leaning(robot: Robot, lean: float) -> np.ndarray:
    """The reference posture (nq,), raised and turned forward by ``lean`` rad about the soles' middle.

    Raises InputError where ankles do not turn that far.
    """
    base, middle = pin.XYZQUATToSE3(robot.reference[:7]), middle_of(robot)
    base.translation = base.translation + RAISED * base.translation[2] * UP

    def turned(angle: float) -> Posture:
        turn = at(middle) * pin.SE3(pin.utils.rotate("y", angle), np.zeros(3)) * at(-middle)
        return stepped_posture(robot, robot.reference, turn * base, soles(robot))

    posture = turned(lean)
    if posture.error > pushing.REACHED:
        most = pushing.largest(lambda angle: turned(angle).error < pushing.REACHED, lean, REACH_ERROR)
        raise InputError(
            f"'{robot.name}' cannot lean by {lean:g} rad, soles flat", f"allowed: up to {most:.3f} rad"
        )
    return posture.q


def build_push_off(
    *, robot: str, hands: str, lean: float, friction: float, wall_friction: float, **given: float | None
) -> Problem:
    """Build the push; see ``FAMILIES`` for the parameters. Raises InputError."""
    body, share = bipeds.humanoid(robot), given.pop("torque_share")
    unit, feet, middle, tilted = Units(body).time, soles(body), middle_of(body), leaning(body, lean)
    chosen = dict(zip(("left", "right"), bipeds.hands(body), strict=True))
    used = tuple(chosen.values()) if hands == "both" else (chosen[hands],)
    arms, radius = shoulders(body, tilted), body.contact(used[0]).radius

    def touching(distance: float) -> Posture:
        x = middle[0] + distance - radius
        places = {name: at([x, *arms[name][1:]]) for name in used}
        return stepped_posture(body, tilted, pin.XYZQUATToSE3(tilted[:7]), {**feet, **places})

    near = float(arms[used[0]][0] - middle[0]) + radius
    way = pushing.largest(
        lambda way: touching(near + way).error < pushing.REACHED, 2 * body.length, REACH_ERROR
    )
    defaults = {"distance": near + ARM_SHARE * way, "push": PUSH * unit, "recover": RECOVER * unit}
    values = common.filled(defaults, given)
    start = touching(values["distance"])
    if start.error > pushing.REACHED:
        raise InputError(
            f"hands of '{body.name}', lean {lean:g} rad, miss a wall {values['distance']:g} m from its soles",
            f"allowed: up to {near + way:.3f} m, and not much nearer than {near:.3f} m",
        )
    place = middle + np.array([values["distance"], 0.0, 0.0])
    wall = Surface(point=place, normal=common.wall_normal(0.0), friction=wall_friction)
    on = (*feet, *used)
    schedule = Schedule(
        (
            Phase(name="push", duration=values["push"], contacts=on, surfaces=dict.fromkeys(used, wall)),
            Phase(name="recover", duration=values["recover"], contacts=tuple(feet)),
        )
    )
    return common.problem(
        "humanoid-push-off",
        body,
        schedule,
        posture_guess(body, schedule, (start.q, start.q, body.reference)),
        torque_share=share,
        friction=friction,
        end=body.reference,
        initial_q=start.q,
        parameters=values,
        default_intervals=INTERVALS,
    )


def build_lean(
    *, robot: str, lean: float, friction: float, table_friction: float, **given: float | None
) -> Problem:
    """Build the reach; see ``FAMILIES`` for the parameters. Raises InputError."""
    body, share = bipeds.humanoid(robot), given.pop("torque_share")
    unit, feet, middle, tilted = Units(body).time, soles(body), middle_of(body), leaning(body, lean)
    up, arms, (left, right) = float(body.reference[2]), shoulders(body, tilted), bipeds.hands(body)
    far = float(arms[left][0] - middle[0])
    defaults = {
        "distance": far,
        "height": TABLE * up,
        "reach": GOAL_AHEAD * far,
        "goal_height": GOAL_UP * up,
        "approach": APPROACH * unit,
        "stretch": REACH * unit,
    }
    values = common.filled(defaults, given)
    place = np.array([middle[0] + values["distance"], arms[left][1], values["height"]])
    goal = np.array([middle[0] + values["reach"], arms[right][1], values["goal_height"]])
    touch = {**feet, left: at(place + body.contact(left).radius * UP)}
    bases = [pin.XYZQUATToSE3(q[:7]) for q in (body.reference, tilted)]
    touched = stepped_posture(body, body.reference, bases[0], touch, move_base=True)
    end = stepped_posture(body, tilted, bases[1], {**touch, right: at(goal)}, move_base=True)
    for posture, what in ((touched, "the table"), (end, "the goal beyond the table")):
        if posture.error > pushing.REACHED:
            raise InputError(
                f"hands of '{body.name}' miss {what} by {posture.error:.3g} m",
                "allowed: nearer places, or another lean to start the search from",
            )
    table = Surface(point=place, normal=UP, friction=table_friction)
    depth, _, thickness = TABLE_SIDES
    shift = np.array([depth / 2 - EDGE, -place[1], -LAYER - thickness / 2])
    solid = BoxObstacle(name="table", sides=np.array(TABLE_SIDES), position=place + shift, rotation=np.eye(3))
    held = {"contacts": (*feet, left), "surfaces": {left: table}, "footholds": {left: place}}
    schedule = Schedule(
        (
            Phase(name="approach", duration=values["approach"], contacts=tuple(feet)),
            Phase(name="stretch", duration=values["stretch"], **held),
        )
    )
    return common.problem(
        "humanoid-lean",
        body,
        schedule,
        posture_guess(body, schedule, (body.reference, touched.q, end.q)),
        torque_share=share,
        friction=friction,
        more=(Clearance(obstacles=(solid,)),),
        end=(FramePose(frame=body.contact(right).frame, position=goal), TerminalRest(q=end.q)),
        parameters=values,
        default_intervals=2 * INTERVALS,
    )


def build_climb(*, robot: str, steps: float, friction: float, **given: float | None) -> Problem:
    """Build the climb; see ``FAMILIES`` for the parameters. Raises InputError."""
    body, count, share = bipeds.humanoid(robot), common.whole("steps", steps), given.pop("torque_share")
    sole, up = 2 * max(contact.half_length for contact in body.contacts), float(body.reference[2])
    defaults = {
        "rise": RISE * up,
        "run": max(RUN * up, SOLES * sole),
        "rail": RAIL * up,
        "move": MOVE * Units(body).time,
    }
    values = common.filled(defaults, given)
    rise, run, rail, move = values.values()
    if not run > sole:
        raise InputError(f"steps are {run:g} m deep for soles of {sole:g} m", "allowed: deeper ones")
    way, middle, poses = np.array([run, 0.0, rise]), middle_of(body), contact_poses(body, body.reference)
    edge = float(middle[0]) - sole / 2 + (1 - BEFORE_HEEL) * run
    terrain = PiecewiseTerrain.stairs(rise, run, count, at=(edge, 0.0), friction=friction)
    (left, right), (left_hand, right_hand) = biped_legs(body), bipeds.hands(body)
    base, feet, hands = pin.XYZQUATToSE3(body.reference[:7]), (left, right), (left_hand, right_hand)
    places, rails, postures = dict(soles(body)), {}, [body.reference]
    phases: list[Phase] = []

    def moved(name: str, on: Sequence[str], shift: np.ndarray, then: Poses, time: float = move) -> None:
        """Add a phase on contacts and the posture at its end, where those of ``then`` are in their places."""
        lands = [each for each in on if phases and each not in phases[-1].contacts]
        touched = {each: rails[each].point if each in rails else places[each].translation for each in lands}
        surfaces = {each: rails[each] for each in on if each in rails}
        phases.append(
            Phase(name=name, duration=time, contacts=tuple(on), surfaces=surfaces, footholds=touched)
        )
        pose, wanted = at(shift) * base, {**{each: places[each] for each in on}, **then}
        found = stepped_posture(body, postures[-1], pose, wanted, move_base=True)
        if found.error > pushing.REACHED:
            raise InputError(
                f"'{body.name}' misses places of contacts in phase '{name}' by {found.error:.3g} m",
                "allowed: lower or less deep steps, or rails at another height",
            )
        postures.append(found.q)
        places.update(then)

    def grasped(hand: str, step: int) -> pin.SE3:
        ahead = np.array([middle[0] + AHEAD * up, APART * poses[hand].translation[1], rail])
        rails[hand] = Surface(point=ahead + (step + 1) * way, normal=UP, bilateral=True)
        return at(rails[hand].point + body.contact(hand).radius * UP)

    for step in range(count):
        aside = np.array([0, *(SWAY * poses[foot].translation[1] for foot in (left, left, right, right))])
        shifts = way * (step + np.transpose([FORWARD, np.zeros(5), UPWARD]))
        shifts[:, 1] = aside
        for index, (hand, other) in enumerate((hands, hands[::-1])):
            on = (*feet, other) if other in rails else feet
            rails.pop(hand, None)
            moved(f"{hand}_{step + 1}", on, shifts[index], {hand: grasped(hand, step)})
        for index, (foot, other) in enumerate((feet[::-1], feet)):
            moved(
                f"{foot}_{step + 1}", (other, *hands), shifts[2 + 2 * index], {foot: at(way) * places[foot]}
            )
            if not index:
                moved(f"double_{step + 1}", (*feet, *hands), shifts[3], {}, move / 2)
    moved("hold", (*feet, *hands), count * way, {}, move / 2)
    moved("rest", feet, count * way, {})
    schedule, end = Schedule(tuple(phases)), common.displaced(body, count * way)
    swing = swing_path(terrain, CLEARANCE * up, reach=sole / 2)
    guess = posture_guess(body, schedule, (*postures[:-1], end), swinging=feet, swing=swing)
    legs = replace(body, contacts=tuple(body.contact(name) for name in feet))  # without the swinging hands
    return common.problem(
        "humanoid-climb",
        body,
        schedule,
        guess,
        torque_share=share,
        terrain=terrain,
        more=swing_clearance(legs, schedule, terrain, height=CLEARANCE * up, guess=guess),
        end=end,
        parameters=values,
        default_intervals=OF_PHASE * len(phases),
    )


def _lean(default: float) -> common.Parameter:
    return common.angle("lean", default, "lean of the body, of which places of hands are derived", (0.0, 1.2))


FAMILIES = (
    Family(
        name="humanoid-push-off",
        robots=bipeds.HUMANOIDS,
        phases=("push", "recover"),
        summary="push off a wall with one hand or both, from leaning far beyond the toes, to standing",
        parameters=(
            _lean(0.35),
            common.choice("hands", "hands on the wall", "both", "left", "right"),
            common.length(
                "distance",
                None,
                "distance of the wall from the soles' middle (default: for bent arms)",
                (0.0, 3.0),
            ),
            common.duration("push", None, "duration until the hands leave the wall", (0.05, 5.0)),
            common.duration("recover", None, "duration from then to rest", (0.05, 10.0)),
            common.friction(0.7, meaning="friction coefficient of the ground"),
            common.friction(0.5, "wall_friction", "friction coefficient of the wall"),
            common.TORQUE_SHARE,
        ),
        build=build_push_off,
    ),
    Family(
        name="humanoid-lean",
        robots=bipeds.HUMANOIDS[:1],
        phases=("approach", "stretch"),
        summary="lean on a table with the left hand to reach far beyond it with the right, at rest",
        parameters=(
            _lean(0.4),
            common.length("distance", None, "distance of the left hand from the soles' middle", (0.0, 3.0)),
            common.length("height", None, "height of the table (default: that of the base)", (0.0, 2.0)),
            common.length(
                "reach", None, "distance of the right hand's goal from the soles' middle", (0.0, 3.0)
            ),
            common.length("goal_height", None, "height of the right hand's goal", (0.0, 3.0)),
            common.duration("approach", None, "duration until touchdown of the left hand", (0.05, 10.0)),
            common.duration("stretch", None, "duration from then to rest at the goal", (0.05, 10.0)),
            common.friction(0.7, meaning="friction coefficient of the ground"),
            common.friction(0.5, "table_friction", "friction coefficient of the table"),
            common.TORQUE_SHARE,
        ),
        build=build_lean,
    ),
    Family(
        name="humanoid-climb",
        robots=bipeds.HUMANOIDS[:1],
        phases=("left_hand", "right_hand", "right", "double", "left", "hold", "rest"),
        summary="climb high steps between two rails, hands and feet one after the other, and rest",
        parameters=(
            common.number("steps", 1.0, "", "number of steps", (1.0, 5.0)),
            common.length("rise", None, "height of a step (default: 0.35 of the base's height)", (0.01, 1.0)),
            common.length("run", None, "depth of a step (default: 0.45 of the base's height)", (0.05, 1.0)),
            common.length(
                "rail", None, "height of the rails over the steps (default: 0.75 of it)", (0.0, 2.0)
            ),
            common.duration("move", None, "duration of the move of a hand or a foot", (0.05, 5.0)),
            common.friction(0.7),
            common.TORQUE_SHARE,
        ),
        build=build_climb,
    ),
)

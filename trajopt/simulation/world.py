"""The complete MuJoCo model of a plan: robot, feet, ground, obstacles, grasps, and pairs that may touch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.collision.near import GROUND
from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.motion.body_distances import FileBodies
from trajopt.motion.carried import carrying_model
from trajopt.motion.samples import ContactPlaces, contact_places
from trajopt.motion.touched import held_samples
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.robot.natural_units import NaturalUnits
from trajopt.simulation.bodies import (
    Bodies,
    add_geom,
    body_name,
    build_bodies,
    compile_bodies,
    mujoco_quaternion,
    part_name,
)
from trajopt.simulation.coordinates import CoordinateMap
from trajopt.simulation.ground import (
    BALL,
    GroundGeometry,
    Surroundings,
    add_ground,
    add_obstacles,
    add_shape,
    height_over,
    surroundings_of,
)
from trajopt.simulation.settings import CONTACT_TIME, SimulationSettings
from trajopt.solution.solution import Solution

# A penetration meets nearly the whole stiffness from the first touch on: d0, dmax, midpoint and power of
# MuJoCo's impedance; its width is the radius of the balls.
IMPEDANCE = (0.95, 0.99, 0.5, 2.0)
# Ratio of friction to pressure in impedance: a contact resists creeping harder than penetration.
FRICTION_STIFFNESS = 10.0
# Links that a plan takes nearer to the ground than this, m, such as its feet, touch nothing.
CLEAR = 1e-3
# A shank that touches the ground this near to its foot, m, counts as the foot: soft feet give way.
AROUND_FOOT = 1e-2
# Friction of links on the ground and on obstacles; it matters only in a fall.
LINK_FRICTION = 0.7
# Relative tolerance of MuJoCo's solver of contact forces: with its default 1e-8, forces of rolling balls
# violate the equations of motion by 1e-5 of the weight.
FORCE_TOLERANCE = 1e-12
# Least time constant of a contact, in steps: MuJoCo's own bound.
LEAST_STEPS = 2.0


@dataclass(frozen=True, kw_only=True)
class Grasp:
    """A contact held over a run of phases: name of its constraint, and whether that fixes its rotation."""

    name: str
    contact: int
    turns: bool
    phases: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class World:
    """A model, its ``bodies`` as specified and ``compiled``, with the indices that the simulation needs.

    Args:
        sites: (nc,) ids of the contact frames' sites.
        contact_of: for each geom, the contact to which it belongs, or -1.
        links, obstacles: whether each geom belongs to a link, and to an obstacle.
        feet: (nc,) distance from each contact frame, m, within which a touch counts as the foot's.
        buried: depth, m, of joints that the plan takes into the ground; they touch nothing.
        models: the `pin.Model` of each phase of the plan, with payloads and the disturbances of the settings.
        pairs, friction: (n,) ids of pairs of feet and ground; (phases, n) their friction, see
            `GroundGeometry`.
    """

    bodies: Bodies
    compiled: Any
    coordinates: CoordinateMap
    units: NaturalUnits
    place: Surroundings
    ground: GroundGeometry
    sites: np.ndarray
    contact_of: np.ndarray
    links: np.ndarray
    feet: np.ndarray
    obstacles: np.ndarray
    grasps: tuple[Grasp, ...]
    buried: dict[str, float]
    models: tuple[pin.Model, ...]
    pairs: np.ndarray
    friction: np.ndarray


def build_world(plan: Solution, settings: SimulationSettings, beyond: float = 0.0) -> World:
    """Build the model of a plan for these settings. Raises `InputError` for what MuJoCo cannot express.

    beyond: m, how far the simulation may leave the plan along the ground.
    """
    units, touching = NaturalUnits.of(plan.model), contact_places(plan)
    bodies = build_bodies(plan.model)
    joints = joint_places(plan)
    place = surroundings_of(plan, touching.position, joints, units.length, settings, beyond)
    buried = _buried(plan, joints, place)
    ground = add_ground(bodies.spec, plan, place)
    feet = _add_feet(bodies, plan, place)
    _add_mimics(bodies, plan)
    links, capsules, obstacles = _add_links(bodies, plan, place, buried)
    grasps = _add_grasps(bodies, plan, touching, _stiffness(settings, units))
    _options(bodies.spec, settings.step(units.time))
    offsets = _offsets_of_links(bodies, links, plan, place)
    pairs, friction = _pairs(bodies.spec, ground, feet, offsets, settings, units)
    for capsule in capsules:
        for obstacle in obstacles:
            _pair(bodies.spec, capsule, obstacle, settings.friction_scale * LINK_FRICTION, settings, units)
    compiled, coordinates = compile_bodies(bodies)
    _friction_of_joints(compiled, coordinates, plan)
    named = {geom: contact for contact, geoms in enumerate(feet) for geom in geoms}
    geoms = [compiled.geom(i).name for i in range(compiled.ngeom)]
    return World(
        bodies=bodies,
        compiled=compiled,
        coordinates=coordinates,
        units=units,
        place=place,
        ground=ground,
        sites=np.array([compiled.site(f"contact{i}").id for i in range(len(feet))], dtype=int),
        contact_of=np.array([named.get(name, -1) for name in geoms], dtype=int),
        links=np.isin(geoms, links),
        feet=np.array([_extent(plan, i) for i in range(len(feet))]) + place.radii + AROUND_FOOT,
        obstacles=np.isin(geoms, obstacles),
        grasps=grasps,
        buried=buried,
        models=tuple(_disturbed(carrying_model(plan, i), settings) for i in range(len(plan.phases))),
        pairs=np.array([compiled.pair(name).id for name in pairs], dtype=int),
        friction=friction,
    )


def joint_places(plan: Solution) -> np.ndarray:
    """World positions (K, njoints - 1, 3) of the joints at the samples of a plan, m."""
    model, data = plan.model, plan.model.createData()
    places = np.zeros((plan.n_samples, model.njoints - 1, 3))
    for row, q in enumerate(plan.q):
        pin.forwardKinematics(model, data, q)
        places[row] = [data.oMi[i].translation for i in range(1, model.njoints)]
    return places


def _buried(plan: Solution, joints: np.ndarray, place: Surroundings) -> dict[str, float]:
    """Depth, m, of the joints that a plan takes so far into the ground that their balls would touch it."""
    lowest = height_over(plan.description.ground, joints).min(axis=0)
    names = list(plan.model.names)[1:]
    return {name: -float(low) for name, low in zip(names, lowest, strict=True) if low < place.ball}


def _disturbed(model: pin.Model, settings: SimulationSettings) -> pin.Model:
    """The robot as simulated, with scaled masses and a shifted centre of mass."""
    scaled, offset = pin.Model(model), np.array(settings.com_offset)
    for index in range(1, model.njoints):
        inertia = model.inertias[index]
        scale = settings.mass_scale
        scaled.inertias[index] = pin.Inertia(scale * inertia.mass, inertia.lever, scale * inertia.inertia)
    if offset.any():
        kind = base_of(model)
        base = scaled.inertias[BASE_JOINT[kind]]
        if kind == "planar":  # the plane's own axes: forward, up
            offset = model.jointPlacements[1].rotation.T @ offset
        lever = base.lever + offset * pin.computeTotalMass(scaled) / base.mass
        scaled.inertias[BASE_JOINT[kind]] = pin.Inertia(base.mass, lever, base.inertia)
    return scaled


def _options(spec: Any, step: float) -> None:
    mujoco = mujoco_package()
    spec.option.timestep = step
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = FRICTION_STIFFNESS
    spec.option.tolerance = FORCE_TOLERANCE
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def touching_places(plan: Solution, contact: int) -> np.ndarray:
    """Points at which a contact touches, in its frame, m: (1, 3) its origin, (4, 3) the corners of a sole."""
    size = plan.description.contacts[contact].half_size
    if size is None:
        return np.zeros((1, 3))
    x, y = size
    return np.array([[x, y, 0.0], [x, -y, 0.0], [-x, -y, 0.0], [-x, y, 0.0]])


def _extent(plan: Solution, contact: int) -> float:
    return float(np.linalg.norm(touching_places(plan, contact), axis=1).max())


def _add_mimics(bodies: Bodies, plan: Solution) -> None:
    """Add equality constraints between the positions of joints of which one follows the other."""
    mujoco = mujoco_package()
    for mimic in plan.description.mimics:
        names = (part_name(bodies.model.getJointId(name), 0) for name in (mimic.joint, mimic.mimics))
        bodies.spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            data=np.pad([mimic.offset, mimic.ratio], (0, int(mujoco.mjNEQDATA) - 2)),
            **dict(zip(("name1", "name2"), names, strict=True)),
        )


def _add_feet(bodies: Bodies, plan: Solution, place: Surroundings) -> list[list[str]]:
    """Add sites of thrusters, and a site and balls at each contact frame; returns the names of the balls."""
    names = []
    for thruster in plan.description.thrusters:
        placed = bodies.model.frames[bodies.model.getFrameId(thruster.frame)]
        bodies.spec.body(body_name(placed.parentJoint)).add_site(
            name=thruster.name,
            pos=placed.placement.translation,
            quat=mujoco_quaternion(placed.placement.rotation),
        )
    for number, frame in enumerate(plan.contact_frames):
        contact_frame = bodies.model.frames[bodies.model.getFrameId(frame)]
        body = bodies.spec.body(body_name(contact_frame.parentJoint))
        body.add_site(
            name=f"contact{number}",
            pos=contact_frame.placement.translation,
            quat=mujoco_quaternion(contact_frame.placement.rotation),
        )
        corners = touching_places(plan, number)
        names.append([f"ball{number}.{i}" for i in range(len(corners))])
        for name, corner in zip(names[-1], corners, strict=True):
            size = [place.sizes[number], 0, 0]
            add_geom(body, name, "sphere", pos=contact_frame.placement.act(corner), size=size)
    return names


def _add_links(
    bodies: Bodies, plan: Solution, place: Surroundings, buried: Mapping[str, float]
) -> tuple[list[str], list[str], list[str]]:
    """Add geoms of links and obstacles; returns their names in three groups.

    The groups are links that touch the ground, links that touch obstacles, and obstacles. Links have the
    shapes of the file; without them, balls at the joints and the file's capsules.
    """
    scene = plan.description.capsule_scene(plan.model)
    obstacles = () if scene is None else add_obstacles(bodies.spec, scene.obstacles)
    known = plan.description.bodies
    if known is None or not known.shapes:
        shapes = () if scene is None else scene.shapes
        solid = [add_shape(bodies, shape, f"shape{i}") for i, shape in enumerate(shapes)]
        return _add_balls(bodies, plan, place, buried), solid, list(obstacles)
    body_scene = plan.description.body_scene(plan.model)
    moving = () if body_scene is None else body_scene.moving
    names = {shape.name: add_shape(bodies, shape, f"shape{i}") for i, shape in enumerate(moving)}
    sunk = _sunk(plan)
    links = [name for shape, name in names.items() if known.above_ground and shape not in sunk]
    return links, list(names.values()), list(obstacles)


def _offsets_of_links(
    bodies: Bodies, links: Sequence[str], plan: Solution, place: Surroundings
) -> dict[str, float]:
    """By how much each link geom's ground is higher than planned, m; in a leg, that of its contact."""
    of_bodies = dict.fromkeys(bodies.names, 0.0)
    joints = [plan.model.frames[plan.model.getFrameId(name)].parentJoint for name in plan.contact_frames]
    chains = [set(plan.model.supports[joint]) for joint in joints]
    for contact, chain in enumerate(chains):
        others = [other for number, other in enumerate(chains) if number != contact and other != chain]
        leg = chain.difference(range(BASE_JOINT[base_of(plan.model)] + 1), *others)
        of_bodies.update({body_name(joint): float(place.offsets[contact]) for joint in leg})
    return {link: of_bodies[bodies.spec.geom(link).parent.name] for link in links}


def _add_balls(bodies: Bodies, plan: Solution, place: Surroundings, buried: Mapping[str, float]) -> list[str]:
    """Add balls at the joints of a robot with a moving base; returns their names."""
    if base_of(plan.model) == "fixed":
        return []
    joints = [i for i in range(1, plan.model.njoints) if plan.model.names[i] not in buried]
    return [
        add_geom(bodies.spec.body(body_name(i)), f"link{i}", "sphere", size=[place.ball, 0, 0])
        for i in joints
    ]


def _sunk(plan: Solution) -> set[str]:
    """Names of shapes that a plan takes into the ground, as those around its feet: they touch nothing."""
    trace = FileBodies.of(plan)[1]["link_depth"]
    deep = (
        trace.values.max(axis=0, initial=-np.inf) > -CLEAR if trace.values.size else np.zeros(0, dtype=bool)
    )
    return {
        name.removesuffix(f" and {GROUND}")
        for name, is_deep in zip(trace.names, deep, strict=True)
        if is_deep
    }


def _add_grasps(
    bodies: Bodies, plan: Solution, touching: ContactPlaces, stiffness: Mapping[str, list[float]]
) -> tuple[Grasp, ...]:
    """Add a constraint for each run of phases in which a contact is held on a bilateral surface."""
    mujoco, held = mujoco_package(), held_samples(plan)
    grasps: list[Grasp] = []
    for contact in range(held.shape[1]):
        phases = [i for i, rows in enumerate(plan.phases) if held[rows.start, contact]]
        runs = np.split(np.array(phases, dtype=int), np.flatnonzero(np.diff(phases) > 1) + 1)
        for run in (run for run in runs if len(run)):
            name, row = f"grasp{len(grasps)}", plan.phases[int(run[0])].start
            bodies.spec.worldbody.add_site(
                name=name,
                pos=touching.position[row, contact],
                quat=mujoco_quaternion(touching.rotation[row, contact]),
            )
            sole = plan.description.contacts[contact].is_sole
            bodies.spec.add_equality(
                name=name,
                type=mujoco.mjtEq.mjEQ_WELD if sole else mujoco.mjtEq.mjEQ_CONNECT,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                name1=f"contact{contact}",
                name2=name,
                active=False,
                **stiffness,
            )
            grasps.append(Grasp(name=name, contact=contact, turns=sole, phases=tuple(int(i) for i in run)))
    return tuple(grasps)


def _pairs(
    spec: Any,
    ground: GroundGeometry,
    feet: list[list[str]],
    links: Mapping[str, float],
    settings: SimulationSettings,
    units: NaturalUnits,
) -> tuple[list[str], np.ndarray]:
    """Add pairs that may touch; returns the names of those of feet, and their friction (phases, pairs)."""
    names: list[str] = []
    friction = [np.zeros((len(ground.friction), 0))]
    for geom, (name, contacts) in enumerate(zip(ground.names, ground.touched_by, strict=True)):
        for contact in contacts:
            mu = settings.friction_scale * ground.friction[:, geom, contact]
            for ball in feet[contact]:
                _pair(spec, ball, name, float(mu.max()), settings, units)
                friction.append(mu[:, None])
                names.append(f"{ball} {name}")
    for name, offset in zip(ground.names, ground.links, strict=True):
        for link in (link for link, height in links.items() if height == offset):
            _pair(spec, link, name, settings.friction_scale * LINK_FRICTION, settings, units)
    return names, np.hstack(friction)


def _pair(
    spec: Any, first: str, second: str, mu: float, settings: SimulationSettings, units: NaturalUnits
) -> None:
    spec.add_pair(
        name=f"{first} {second}",
        geomname1=first,
        geomname2=second,
        condim=3 if mu > 0 else 1,
        friction=[mu, mu, 0.0, 0.0, 0.0],
        **_stiffness(settings, units),
    )


def _stiffness(settings: SimulationSettings, units: NaturalUnits) -> dict[str, list[float]]:
    """Stiffness of contacts and grasps as MuJoCo parameters."""
    least = LEAST_STEPS * settings.step(units.time)
    d0, d1, middle, power = IMPEDANCE
    return {
        "solref": [max(CONTACT_TIME * units.time, least), 1.0],
        "solimp": [d0, d1, BALL * units.length, middle, power],
    }


def _friction_of_joints(compiled: Any, coordinates: CoordinateMap, plan: Solution) -> None:
    """Add friction of drives, and springs, damping and dry friction of joints, to a compiled model."""
    for force in plan.description.joint_forces:
        _, v = force.entries(plan.model)
        row = coordinates.rows[v]
        joint = compiled.dof_jntid[row]
        compiled.jnt_stiffness[joint] += force.stiffness
        compiled.qpos_spring[compiled.jnt_qposadr[joint]] = force.rest
        compiled.dof_damping[row] += force.damping
        compiled.dof_frictionloss[row] += force.dry_friction
    rows = coordinates.rows[plan.actuated_rows]
    for row, drive in zip(rows, plan.drives, strict=False):  # thrusters, which come last, have none
        if drive is not None:
            compiled.dof_damping[row] += drive.viscous_friction
            compiled.dof_frictionloss[row] += drive.coulomb_friction

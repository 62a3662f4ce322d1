"""A scene in MuJoCo: robot, feet, ground, obstacles, grasps, and pairs that may touch; it knows no plan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.motion.description import PlannedContact
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.robot.natural_units import NaturalUnits
from trajopt.simulation.bodies import (
    Bodies,
    body_name,
    build_bodies,
    compile_bodies,
    mujoco_quaternion,
    part_name,
)
from trajopt.simulation.coordinates import CoordinateMap
from trajopt.simulation.ground import (
    GroundGeometry,
    Surroundings,
    add_geom,
    add_ground,
    add_obstacles,
    add_shape,
    surroundings_of,
)
from trajopt.simulation.settings import CONTACT_TIME, SimulationSettings
from trajopt.simulation.site import BALL, Grasp, SceneRobot, Site

# A penetration meets nearly the whole stiffness from the first touch on: d0, dmax, midpoint and power of
# MuJoCo's impedance; its width is the radius of the balls.
IMPEDANCE = (0.95, 0.99, 0.5, 2.0)
# Ratio of friction to pressure in impedance: a contact resists creeping harder than penetration.
FRICTION_STIFFNESS = 10.0
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
class Scene:
    """A robot on its site as a MuJoCo model, with the indices that a simulation needs.

    Args:
        bodies: the model as specified.
        compiled: the compiled model.
        coordinates: map of the coordinates.
        place: the site, with sizes of contacts and ground.
        sites: ids (nc,) of the contact frames' sites.
        contact_of: for each geom, the contact to which it belongs, or -1.
        links: whether each geom belongs to a link.
        feet: distance (nc,) from each contact frame, m, within which a touch counts as the foot's.
        obstacles: whether each geom belongs to an obstacle.
        models: the `pin.Model` of each phase, with payloads and the disturbances of the settings.
        pairs: ids (n,) of pairs of feet and ground.
        friction: friction (phases, n) of these pairs, see `GroundGeometry`.
    """

    bodies: Bodies
    compiled: Any
    coordinates: CoordinateMap
    place: Surroundings
    sites: np.ndarray
    contact_of: np.ndarray
    links: np.ndarray
    feet: np.ndarray
    obstacles: np.ndarray
    models: tuple[pin.Model, ...]
    pairs: np.ndarray
    friction: np.ndarray

    @property
    def site(self) -> Site:
        """The robot, and what it touches in each phase."""
        return self.place.site

    @property
    def robot(self) -> SceneRobot:
        """The robot of the scene."""
        return self.site.robot

    @property
    def units(self) -> NaturalUnits:
        """Natural units of the robot."""
        return self.site.robot.units

    @property
    def rows(self) -> np.ndarray:
        """Rows of MuJoCo's velocity with a motor, in the order of the inputs."""
        return self.coordinates.rows[self.site.robot.actuated_rows]


def build_scene(site: Site, settings: SimulationSettings) -> Scene:
    """Compile a scene with these settings. Raises `InputError` for what MuJoCo cannot express."""
    robot, place = site.robot, surroundings_of(site, settings)
    bodies, units = build_bodies(robot.model), robot.units
    ground = add_ground(bodies.spec, place)
    feet = _add_feet(bodies, robot, place)
    _add_mimics(bodies, robot)
    links, capsules, obstacles = _add_links(bodies, place)
    _add_grasps(bodies, site.grasps, _stiffness(settings, units))
    _options(bodies.spec, settings.step(units.time))
    offsets = _offsets_of_links(bodies, links, robot, place)
    pairs, friction = _pairs(bodies.spec, ground, feet, offsets, settings, units)
    for capsule in capsules:
        for obstacle in obstacles:
            _pair(bodies.spec, capsule, obstacle, settings.friction_scale * LINK_FRICTION, settings, units)
    compiled, coordinates = compile_bodies(bodies)
    _friction_of_joints(compiled, coordinates, robot)
    named = {geom: contact for contact, geoms in enumerate(feet) for geom in geoms}
    geoms = [compiled.geom(i).name for i in range(compiled.ngeom)]
    extents = [_extent(contact) for contact in robot.description.contacts]
    return Scene(
        bodies=bodies,
        compiled=compiled,
        coordinates=coordinates,
        place=place,
        sites=np.array([compiled.site(f"contact{i}").id for i in range(len(feet))], dtype=int),
        contact_of=np.array([named.get(name, -1) for name in geoms], dtype=int),
        links=np.isin(geoms, links),
        feet=np.array(extents) + place.radii + AROUND_FOOT,
        obstacles=np.isin(geoms, obstacles),
        models=tuple(_disturbed(model, settings) for model in site.models),
        pairs=np.array([compiled.pair(name).id for name in pairs], dtype=int),
        friction=friction,
    )


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


def touching_places(contact: PlannedContact) -> np.ndarray:
    """Points at which a contact touches, in its frame, m: (1, 3) its origin, (4, 3) the corners of a sole."""
    if contact.half_size is None:
        return np.zeros((1, 3))
    x, y = contact.half_size
    return np.array([[x, y, 0.0], [x, -y, 0.0], [-x, -y, 0.0], [-x, y, 0.0]])


def _extent(contact: PlannedContact) -> float:
    return float(np.linalg.norm(touching_places(contact), axis=1).max())


def _add_mimics(bodies: Bodies, robot: SceneRobot) -> None:
    """Add equality constraints between the positions of joints of which one follows the other."""
    mujoco = mujoco_package()
    for mimic in robot.description.mimics:
        names = (part_name(bodies.model.getJointId(name), 0) for name in (mimic.joint, mimic.mimics))
        bodies.spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            data=np.pad([mimic.offset, mimic.ratio], (0, int(mujoco.mjNEQDATA) - 2)),
            **dict(zip(("name1", "name2"), names, strict=True)),
        )


def _add_feet(bodies: Bodies, robot: SceneRobot, place: Surroundings) -> list[list[str]]:
    """Add sites of thrusters, and a site and balls at each contact frame; returns the names of the balls."""
    names = []
    for thruster in robot.description.thrusters:
        placed = bodies.model.frames[bodies.model.getFrameId(thruster.frame)]
        bodies.spec.body(body_name(placed.parentJoint)).add_site(
            name=thruster.name,
            pos=placed.placement.translation,
            quat=mujoco_quaternion(placed.placement.rotation),
        )
    for number, contact in enumerate(robot.description.contacts):
        contact_frame = bodies.model.frames[bodies.model.getFrameId(contact.frame)]
        body = bodies.spec.body(body_name(contact_frame.parentJoint))
        body.add_site(
            name=f"contact{number}",
            pos=contact_frame.placement.translation,
            quat=mujoco_quaternion(contact_frame.placement.rotation),
        )
        corners = touching_places(contact)
        names.append([f"ball{number}.{i}" for i in range(len(corners))])
        for name, corner in zip(names[-1], corners, strict=True):
            size = [place.sizes[number], 0, 0]
            add_geom(body, name, "sphere", pos=contact_frame.placement.act(corner), size=size)
    return names


def _add_links(bodies: Bodies, place: Surroundings) -> tuple[list[str], list[str], list[str]]:
    """Add geoms of links and obstacles; returns their names in three groups.

    The groups are links that touch the ground, links that touch obstacles, and obstacles. Links have the
    shapes of the description; without them, balls at the joints and the capsules of older files.
    """
    site, robot = place.site, place.site.robot
    scene, known = robot.description.capsule_scene(robot.model), robot.description.bodies
    obstacles = () if scene is None else add_obstacles(bodies.spec, scene.obstacles)
    if known is None or not known.shapes:
        shapes = () if scene is None else scene.shapes
        solid = [add_shape(bodies, shape, f"shape{i}") for i, shape in enumerate(shapes)]
        return _add_balls(bodies, place), solid, list(obstacles)
    body_scene = robot.description.body_scene(robot.model)
    every = () if body_scene is None else body_scene.moving
    moving = [shape for shape in every if shape.name not in known.carried]
    names = {shape.name: add_shape(bodies, shape, f"shape{i}") for i, shape in enumerate(moving)}
    links = [name for shape, name in names.items() if known.above_ground and shape not in site.sunk]
    return links, list(names.values()), list(obstacles)


def _offsets_of_links(
    bodies: Bodies, links: Sequence[str], robot: SceneRobot, place: Surroundings
) -> dict[str, float]:
    """By how much each link geom's ground is higher than planned, m; in a leg, that of its contact."""
    of_bodies, model = dict.fromkeys(bodies.names, 0.0), robot.model
    joints = [model.frames[model.getFrameId(name)].parentJoint for name in robot.description.frames]
    chains = [set(model.supports[joint]) for joint in joints]
    for contact, chain in enumerate(chains):
        others = [other for number, other in enumerate(chains) if number != contact and other != chain]
        leg = chain.difference(range(BASE_JOINT[robot.base] + 1), *others)
        of_bodies.update({body_name(joint): float(place.offsets[contact]) for joint in leg})
    return {link: of_bodies[bodies.spec.geom(link).parent.name] for link in links}


def _add_balls(bodies: Bodies, place: Surroundings) -> list[str]:
    """Add balls at the joints of a robot with a moving base; returns their names."""
    site, model = place.site, place.site.robot.model
    if site.robot.base == "fixed":
        return []
    joints = [i for i in range(1, model.njoints) if model.names[i] not in site.buried]
    return [
        add_geom(bodies.spec.body(body_name(i)), f"link{i}", "sphere", size=[place.ball, 0, 0])
        for i in joints
    ]


def _add_grasps(bodies: Bodies, grasps: Sequence[Grasp], stiffness: Mapping[str, list[float]]) -> None:
    """Add a site and a constraint, which is not active yet, for each grasp."""
    mujoco = mujoco_package()
    for grasp in grasps:
        quaternion = mujoco_quaternion(grasp.rotation)
        bodies.spec.worldbody.add_site(name=grasp.name, pos=grasp.position, quat=quaternion)
        bodies.spec.add_equality(
            name=grasp.name,
            type=mujoco.mjtEq.mjEQ_WELD if grasp.turns else mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=f"contact{grasp.contact}",
            name2=grasp.name,
            active=False,
            **stiffness,
        )


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


def _friction_of_joints(compiled: Any, coordinates: CoordinateMap, robot: SceneRobot) -> None:
    """Add friction of drives, and springs, damping and dry friction of joints, to a compiled model."""
    for force in robot.description.joint_forces:
        _, v = force.entries(robot.model)
        row = coordinates.rows[v]
        joint = compiled.dof_jntid[row]
        compiled.jnt_stiffness[joint] += force.stiffness
        compiled.qpos_spring[compiled.jnt_qposadr[joint]] = force.rest
        compiled.dof_damping[row] += force.damping
        compiled.dof_frictionloss[row] += force.dry_friction
    rows = coordinates.rows[robot.actuated_rows]
    for row, drive in zip(rows, robot.drives, strict=False):  # thrusters, which come last, have none
        if drive is not None:
            compiled.dof_damping[row] += drive.viscous_friction
            compiled.dof_frictionloss[row] += drive.coulomb_friction

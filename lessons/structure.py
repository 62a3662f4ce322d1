"""Structure of the rigid-body dynamics: blocks of M, momentum, Coriolis matrix, energy, gravity.

Notation is Pinocchio's. The **base** is a joint: the root if it is a free-flyer or planar, else none (a fixed
base has no rows). For virtual joints (a chain of prismatic and revolute ones), pass the name of the last as
``base_joint``. Frame B has the axes and origin of that joint; G has the world's axes at the centre of mass c.
``J_b`` (6, nb) maps the base's rates to the twist of B in B (linear first), the identity for a free-flyer.
The transport of wrenches and momenta from G to B is

    X = [ R^T                  0   ]
        [ -R^T [p - c]x       R^T  ]        R, p: orientation and origin of B in the world

and with the momentum h_G = A_G v, the base rows of M are ``J_b^T X A_G``, momentum in the base's coordinates
(Orin, Goswami, Lee, "Centroidal dynamics of a humanoid robot", 2013). Armature is not part of the momentum:
rotors only add to the diagonal of M.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.dynamics import rigid_body
from trajopt.dynamics.base_joint import BASE_JOINT, BASE_ROWS, base_of
from trajopt.dynamics.model_content import joint_kind, once_per_content
from trajopt.dynamics.model_quantities import mass_matrix_at, require_shapes
from trajopt.errors import InputError
from trajopt_library.lessons import lagrange

# Relative tolerance on gravity that a base cannot follow, and on the singular values of a base Jacobian.
UNREACHABLE = 1e-9
SINGULAR = 1e-9


@dataclass(frozen=True, kw_only=True)
class MassBlocks:
    """``M = [[base, coupling], [coupling^T, joints]]``: (nb, nb), (nb, nj), (nj, nj)."""

    base: np.ndarray
    coupling: np.ndarray
    joints: np.ndarray


@dataclass(frozen=True, kw_only=True)
class CompositeInertia:
    """All links as one rigid body: mass kg, centre (3,) m in the world, rotational (3, 3) kg m^2.

    ``rotational`` is the inertia about the centre in world axes.
    """

    mass: float
    centre: np.ndarray
    rotational: np.ndarray

    def matrix(self, placement: pin.SE3) -> np.ndarray:
        """Return the spatial inertia (6, 6), linear first, at the origin and in the axes of ``placement``."""
        return placement.actInv(pin.Inertia(self.mass, self.centre, self.rotational)).matrix()


@dataclass(frozen=True, kw_only=True)
class MomentumMaps:
    """Momentum matrices at a configuration, and the maps between their frames.

    centroidal: (6, nv), A_G: linear and angular momentum in world axes about the centre of mass.
    base_from_centroidal: (6, 6), X of the module: maps a wrench or momentum from G to B.
    base_jacobian: (6, nb), J_b of the module.
    placement: B in the world.
    """

    centroidal: np.ndarray
    base_from_centroidal: np.ndarray
    base_jacobian: np.ndarray
    placement: pin.SE3

    @property
    def base(self) -> np.ndarray:
        """Momentum in the base's axes about the base's origin, (6, nv)."""
        return self.base_from_centroidal @ self.centroidal

    @property
    def rows_of_mass_matrix(self) -> np.ndarray:
        """Base rows of M without armature, ``J_b^T X A_G``, (nb, nv)."""
        return self.base_rows(self.centroidal)

    def base_rows(self, wrench: np.ndarray) -> np.ndarray:
        """Return the base rows (nb, ...) of a wrench or momentum (6, ...) at G."""
        return self.base_jacobian.T @ self.base_from_centroidal @ wrench

    def at_centre_of_mass(self, base_rows: np.ndarray) -> np.ndarray:
        """Return the wrench (6, ...) at G with the given base rows.

        Raises `InputError` unless six base rates move the base in six directions (no gimbal lock).
        """
        singular = np.linalg.svd(self.base_jacobian, compute_uv=False)
        if len(singular) < 6 or singular[-1] < SINGULAR * singular[0]:
            rank = int((singular > SINGULAR * singular[:1]).sum())
            raise InputError(
                f"base rows of rank {rank} do not determine a wrench", "a base with 6 independent rates"
            )
        return np.linalg.solve(self.base_jacobian.T @ self.base_from_centroidal, base_rows)


@dataclass(frozen=True, kw_only=True)
class KineticEnergy:
    """Kinetic energy in J, computed in two ways.

    translation, rotation: (n,), ``1/2 m |v_c|^2`` and ``1/2 omega^T I omega`` of the link of joint k + 1.
    armature: ``1/2 sum armature_j v_j^2`` of the rotors, which turn with their joints.
    quadratic_form: ``1/2 v^T M v``, equal to the sum of the others.
    """

    translation: np.ndarray
    rotation: np.ndarray
    armature: float
    quadratic_form: float


def mass_blocks(model: pin.Model, q: np.ndarray, base_joint: str | None = None) -> MassBlocks:
    """Return the blocks of M at q (nq,) by base and joints; raises `InputError` for a wrong base or shape."""
    matrix, rows = mass_matrix_at(model, q), base_joint_and_rows(model, base_joint)[1]
    return MassBlocks(base=matrix[:rows, :rows], coupling=matrix[:rows, rows:], joints=matrix[rows:, rows:])


def composite_inertia(model: pin.Model, q: np.ndarray) -> CompositeInertia:
    """Return the inertia of all links at q (nq,) with welded joints: ``sum X_L^* I_L X_L``."""
    require_shapes(model, q=q)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    total = pin.Inertia.Zero()
    for placement, inertia in list(zip(data.oMi, model.inertias, strict=True))[1:]:
        total = total + placement.act(inertia)
    return CompositeInertia(mass=total.mass, centre=total.lever, rotational=total.inertia)


def momentum_maps(model: pin.Model, q: np.ndarray, base_joint: str | None = None) -> MomentumMaps:
    """Return the momentum matrices at q (nq,); raises `InputError` for a wrong base or shape."""
    require_shapes(model, q=q)
    joint, rows = base_joint_and_rows(model, base_joint)
    data = model.createData()
    centroidal = pin.computeCentroidalMap(model, data, q).copy()
    pin.computeJointJacobians(model, data, q)
    placement, centre = data.oMi[joint].copy(), pin.centerOfMass(model, data, q)
    to_base = placement.actInv(pin.SE3(np.eye(3), centre)).toDualActionMatrix()
    twist = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, :rows] if rows else np.zeros((6, 0))
    return MomentumMaps(
        centroidal=centroidal, base_from_centroidal=to_base, base_jacobian=twist, placement=placement
    )


def coriolis_matrix_at(model: pin.Model, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return C (nv, nv), with Coriolis and centrifugal forces ``C v`` and ``M' - 2 C`` skew symmetric.

    It is Pinocchio's, in Christoffel form. Pinocchio leaves out the rate of the axes of spherical ZYX joints,
    so models with such joints use `lagrange.coriolis_matrix`. Raises `UnsupportedJointError` as
    `rigid_body` does.
    """
    require_shapes(model, q=q, v=v)
    if any(joint_kind(model, index) == "SphericalZYX" for index in range(1, model.njoints)):
        return lagrange.coriolis_matrix(model)(q, v).full()
    return pin.computeCoriolisMatrix(model, model.createData(), q, v).copy()


def kinetic_energy_parts(model: pin.Model, q: np.ndarray, v: np.ndarray) -> KineticEnergy:
    """Return the kinetic energy at q (nq,), v (nv,), link by link and from M."""
    require_shapes(model, q=q, v=v)
    data = model.createData()
    pin.forwardKinematics(model, data, q, v)
    translation, rotation = [], []
    for twist, inertia in list(zip(data.v, model.inertias, strict=True))[1:]:
        centre_velocity = twist.linear + np.cross(twist.angular, inertia.lever)
        translation.append(inertia.mass * centre_velocity @ centre_velocity / 2)
        rotation.append(twist.angular @ inertia.inertia @ twist.angular / 2)
    return KineticEnergy(
        translation=np.array(translation),
        rotation=np.array(rotation),
        armature=float(model.armature @ v**2 / 2),
        quadratic_form=float(v @ mass_matrix_at(model, q) @ v / 2),
    )


def gravity_from_base_columns(model: pin.Model, q: np.ndarray, base_joint: str | None = None) -> np.ndarray:
    """Return generalised gravity (nv,) as ``G = - M [a_b; 0]``, M without armature: free fall needs no force.

    ``a_b`` (nb,) are the rate derivatives of a base that falls from rest, ``J_b a_b = [R^T g; 0]``. For a
    free-flyer this is gravity in the base's axes, not the world's. Raises `InputError` if the base cannot
    fall (a fixed base, or a plane that is not along gravity), and for a wrong base or shape.
    """
    maps = momentum_maps(model, q, base_joint)
    rows = maps.base_jacobian.shape[1]
    fall = np.concatenate([maps.placement.rotation.T @ model.gravity.linear, np.zeros(3)])
    rates = np.linalg.lstsq(maps.base_jacobian, fall, rcond=None)[0]
    if np.linalg.norm(maps.base_jacobian @ rates - fall) > UNREACHABLE * np.linalg.norm(fall):
        raise InputError("the base cannot fall along gravity", "a base that moves along it; gravity_vector")
    massive = mass_matrix_at(model, q) - np.diag(model.armature)
    return -massive[:, :rows] @ rates


def gravity_vector(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Return generalised gravity (nv,) for any base: ``G = - m Jcom^T g``, from the linear rows of A_G."""
    return -momentum_maps(model, q).centroidal[:3].T @ model.gravity.linear


@once_per_content
def momentum_matrix(model: pin.Model) -> ca.Function:
    """Return A_G on SX, ``q -> (6, nv)``, in world axes about the centre of mass."""
    q, v = ca.SX.sym("q", model.nq), ca.SX.sym("v", model.nv)
    matrix = ca.jacobian(rigid_body.centroidal_momentum(model)(q, v), v)
    return ca.Function("momentum_matrix", [q], [matrix], ["q"], ["A"])


@once_per_content
def mass_matrix_rate(model: pin.Model) -> ca.Function:
    """Return the rate of M along a motion on SX, ``(q, v) -> M'`` (nv, nv), an exact derivative."""
    q, v, t = ca.SX.sym("q", model.nq), ca.SX.sym("v", model.nv), ca.SX.sym("t")
    along = rigid_body.mass_matrix(model)(rigid_body.integrate(model)(q, t * v))
    rate = ca.Function("rate", [t, q, v], [ca.reshape(ca.jacobian(ca.vec(along), t), along.shape)])
    return ca.Function("mass_matrix_rate", [q, v], [rate(0, q, v)], ["q", "v"], ["M_rate"])


def base_joint_and_rows(model: pin.Model, base_joint: str | None) -> tuple[int, int]:
    """Return the index of the base's joint (0: the world) and the number of base rows.

    Raises `InputError` if ``base_joint`` is not a base: it is unknown, does not carry all other links, or is
    behind joints with mass.
    """
    if base_joint is None:
        base = base_of(model)
        return BASE_JOINT[base], BASE_ROWS[base]
    if not model.existJointName(base_joint):
        raise InputError(f"base joint '{base_joint}' is unknown", "one of " + ", ".join(model.names[1:]))
    joint = model.getJointId(base_joint)
    if list(model.supports[joint]) != list(range(joint + 1)):
        raise InputError(
            f"joints before '{base_joint}' are not a chain to it", "the base's joints come first"
        )
    if any(model.inertias[index].mass for index in range(1, joint)):
        raise InputError(f"virtual joints before '{base_joint}' carry mass", "massless ones")
    others = [index for index in range(joint + 1, model.njoints) if joint not in model.supports[index]]
    if others:
        raise InputError(f"joint '{model.names[others[0]]}' is not behind '{base_joint}'", "all must be")
    return joint, model.joints[joint].idx_v + model.joints[joint].nv

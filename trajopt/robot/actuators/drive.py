"""Drives: a motor behind a gear on one joint, and the joint's resulting limits and inertia.

Names with ``motor_`` (and the fields that say so) are on the motor side, at the motor's shaft; everything
else is on the joint side. For a lossless gear with ratio n (motor turns per joint turn),

    motor_speed = n rate,    motor_torque = torque / n,    reflected inertia = n^2 I_r

(Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, 2006, sec. 6.2 and 7.5). For a prismatic joint
forces are in N, rates in m/s and the ratio in rad/m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from trajopt.arguments import NonNegative, Positive, UnboundedPositive, checked
from trajopt.errors import InputError

Quantity = TypeVar("Quantity", float, np.ndarray, ca.SX)

# Joint speed, rad/s, at which smoothed Coulomb friction reaches tanh(1) = 76 %: a hundredth of the speeds
# that legs and arms reach.
COULOMB_SPEED = 0.1


@checked
@dataclass(frozen=True, kw_only=True)
class Drive:
    """A motor and its gear on one joint of one degree of freedom.

    The motor equation V = R i + k_e omega with |V| <= V_max gives the voltage line |tau_m / stall_torque +
    omega_m / no_load_speed| <= 1 (Hughes and Drury, Electric Motors and Drives, 2013, sec. 3.4).

    Args:
        gear_ratio: n, motor turns per joint turn; negative if they turn in opposite directions, never zero.
        rotor_inertia: inertia of the rotor about its axis, motor side, kg m^2; 0 keeps the model's armature.
        viscous_friction: viscous friction, joint side, N m s/rad.
        coulomb_friction: Coulomb friction, joint side, N m, smoothed as tanh(rate / coulomb_speed).
        coulomb_speed: speed scale of the smoothing, joint side, rad/s.
        torque_limit: torque at the largest current, motor side, N m.
        stall_torque: torque at which the voltage line meets zero speed, motor side, N m.
        no_load_speed: speed at which the voltage line meets zero torque, motor side, rad/s.

    Raises:
        InputError: for a gear ratio of zero, NaN, negative friction or inertia, or limits not above zero.
    """

    gear_ratio: float
    rotor_inertia: NonNegative = 0.0
    viscous_friction: NonNegative = 0.0
    coulomb_friction: NonNegative = 0.0
    coulomb_speed: Positive = COULOMB_SPEED
    torque_limit: UnboundedPositive = math.inf
    stall_torque: UnboundedPositive = math.inf
    no_load_speed: UnboundedPositive = math.inf

    def __post_init__(self) -> None:
        if self.gear_ratio == 0:
            raise InputError("gear_ratio of Drive is 0", "allowed: a finite number, not zero")
        if math.isfinite(self.stall_torque) != math.isfinite(self.no_load_speed):
            raise InputError(
                f"a drive has stall_torque={self.stall_torque:g} and no_load_speed={self.no_load_speed:g}",
                "allowed: both finite, which gives the voltage line, or neither",
            )

    @classmethod
    @checked
    def from_motor(
        cls,
        *,
        gear_ratio: float,
        voltage: Positive,
        resistance: Positive,
        torque_constant: Positive,
        back_emf_constant: Positive | None = None,
        current_limit: UnboundedPositive = math.inf,
        **others: float,
    ) -> Drive:
        """Drive of a motor with ``V = R i + k_e omega`` and ``tau_m = k_t i``, all on the motor side.

        For a three-phase motor in amplitudes, k_t = 3/2 k_e and the voltage is the largest phase amplitude.

        Args:
            gear_ratio: n, motor turns per joint turn.
            voltage: largest voltage, V.
            resistance: R, ohm.
            torque_constant: k_t, N m/A.
            back_emf_constant: k_e, V s/rad; default k_t, as for a direct-current motor.
            current_limit: largest current, A.
            others: further fields of `Drive`.

        Raises:
            InputError: for numbers not above zero.
        """
        return cls(
            gear_ratio=gear_ratio,
            torque_limit=torque_constant * current_limit,
            stall_torque=torque_constant * voltage / resistance,
            no_load_speed=voltage / (torque_constant if back_emf_constant is None else back_emf_constant),
            **others,
        )

    @classmethod
    def from_meta(cls, meta: Any) -> Drive:
        """Drive from its description in a solution file. Raises `InputError` for a malformed one."""
        names = {field.name for field in fields(cls)}
        if not isinstance(meta, Mapping) or not set(meta) <= names or "gear_ratio" not in meta:
            raise InputError("a drive in meta is not an object of its fields", ", ".join(sorted(names)))
        return cls(**{name: math.inf if value is None else value for name, value in meta.items()})

    def to_meta(self) -> dict[str, float | None]:
        """Fields for JSON, which has no infinity: null means no limit."""
        return {name: value if math.isfinite(value) else None for name, value in asdict(self).items()}

    @property
    def armature(self) -> float:
        """Rotor inertia reflected to the joint, n^2 I_r, kg m^2."""
        return self.gear_ratio**2 * self.rotor_inertia

    @property
    def joint_torque_limit(self) -> float:
        """The motor's torque limit on the joint side, |n| torque_limit, N m."""
        return abs(self.gear_ratio) * self.torque_limit

    @property
    def joint_no_load_speed(self) -> float:
        """The no-load speed on the joint side, no_load_speed / |n|, rad/s."""
        return self.no_load_speed / abs(self.gear_ratio)

    def motor_torque(self, torque: Quantity) -> Quantity:
        """Motor torque, N m, for a torque delivered to the joint."""
        return torque / self.gear_ratio

    def motor_speed(self, rate: Quantity) -> Quantity:
        """Motor speed, rad/s, at a joint rate."""
        return self.gear_ratio * rate

    def friction_torque(self, rate: Quantity) -> Quantity:
        """Friction that the drive has to overcome, N m, joint side, with the sign of ``rate``."""
        share = rate / self.coulomb_speed
        direction = ca.tanh(share) if isinstance(share, ca.SX) else np.tanh(share)
        return self.viscous_friction * rate + self.coulomb_friction * direction

    def voltage_use(self, torque: Quantity, rate: Quantity) -> Quantity:
        """Voltage relative to the largest, tau_m / stall_torque + omega_m / no_load_speed; allowed -1 to 1.

        ``torque``, N m, and ``rate``, rad/s, are on the joint side; zero without a voltage line.
        """
        return self.motor_torque(torque) / self.stall_torque + self.motor_speed(rate) / self.no_load_speed

    def torque_range(self, rate: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest torque, N m, joint side, that voltage and current allow at a joint rate.

        Empty (least above largest) at rates that no current can sustain.
        """
        reach = abs(self.gear_ratio) * self.stall_torque
        induced = np.asarray(rate, dtype=float) / self.joint_no_load_speed
        line = reach * np.array([-1 - induced, 1 - induced]) if math.isfinite(reach) else [-reach, reach]
        limit = self.joint_torque_limit
        return np.maximum(line[0], -limit), np.minimum(line[1], limit)

    def envelope_margin(self, torque: float | np.ndarray, rate: float | np.ndarray) -> np.ndarray:
        """Least unused fraction of voltage and motor torque at an operating point; negative past a limit."""
        voltage = 1 - np.abs(self.voltage_use(np.asarray(torque), np.asarray(rate)))
        current = 1 - np.abs(self.motor_torque(np.asarray(torque))) / self.torque_limit
        return np.minimum(voltage, current)

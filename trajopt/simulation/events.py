"""Events of a simulation: what changes with the phase, pushes on the base, and wrenches on links.

Events of the user's own (`Event`) come last at each tick.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from trajopt.control.reference import ContactTimeline
from trajopt.dynamics.base_joint import BASE_JOINT
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.bodies import body_name, write_inertias
from trajopt.simulation.scene import Scene
from trajopt.simulation.settings import Impulse, SimulationSettings

# Horizontal part of the forward axis below which a push is reduced: a vertical base has no side.
LEAST_LEVEL = 0.1
# A push lasts this fraction of the motion, around its middle.
PUSHED = 0.1
# Least friction coefficient, as in MuJoCo's own compiler, since MuJoCo takes them to be positive.
LEAST_FRICTION = 1e-5


class Events:
    """The events of one simulation.

    Args:
        scene: the scene.
        timeline: ticks and their phases; the last phase goes on after the last tick.
        settings: scales of masses, pushes, wrenches, and events of the user.

    Attributes:
        impulses: impulses on the base; others may be set at any time.
    """

    def __init__(self, scene: Scene, timeline: ContactTimeline, settings: SimulationSettings) -> None:
        self._scene, self._timeline, self._push = scene, timeline, settings.push
        self._reweighed = settings.mass_scale != 1.0 or any(settings.com_offset)
        self.impulses: tuple[Impulse, ...] = settings.impulses
        self._forces: dict[Impulse, np.ndarray] = {}
        kind, model = scene.robot.base, scene.compiled
        self._own, self._pair_friction = tuple(settings.events), model.pair_friction.copy()
        self._base = None if kind == "fixed" else model.body(body_name(BASE_JOINT[kind])).id
        wrenches = (*scene.robot.description.wrenches, *settings.wrenches)
        self._wrenches = [(wrench, *wrench.place(scene.robot.model)) for wrench in wrenches]
        gravity = np.linalg.norm(model.opt.gravity)
        self._up = -model.opt.gravity / gravity if gravity > 0 else np.array([0.0, 0.0, 1.0])

    def apply(self, k: int, data: Any, *, anew: bool) -> None:
        """Apply the events of tick ``k``; ``anew`` also those that earlier ticks have applied."""
        phases = self._timeline.source
        now, before = (int(phases[min(tick, len(phases) - 1)]) for tick in (k, max(k - 1, 0)))
        if self._own or self._wrenches:
            data.xfrc_applied[:] = 0.0
        if self._own:
            self._scene.compiled.pair_friction[:] = self._pair_friction
        if self._own or anew or now != before:
            self.enter(now, data)
        if self._base is not None and (self._push or self.impulses):
            data.xfrc_applied[self._base, :3] = self._pushed(k, data)
        if self._wrenches:
            self._load(float(self._timeline.t[0]) + k * self._timeline.period, data)
        for event in self._own:
            event.apply(k * self._timeline.period, self._scene.compiled, data)

    def enter(self, phase: int, data: Any) -> None:
        """Apply what changes with a phase: payloads, grasps, and friction under contacts."""
        scene, model = self._scene, self._scene.compiled
        if scene.robot.description.payloads or self._reweighed:
            write_inertias(model, scene.models[phase])
        for grasp in scene.site.grasps:
            data.eq_active[model.equality(grasp.name).id] = phase in grasp.phases
        friction = np.maximum(scene.friction[phase], LEAST_FRICTION)
        model.pair_friction[scene.pairs, :2] = friction[:, None]

    def _load(self, t: float, data: Any) -> None:
        """Add the wrenches of time ``t``, s, at the centres of mass of their links."""
        mujoco_package().mj_kinematics(self._scene.compiled, data)
        for wrench, joint, place in self._wrenches:
            body, (force, torque) = self._scene.compiled.body(body_name(joint)).id, np.split(wrench.at(t), 2)
            point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place.translation
            data.xfrc_applied[body, :3] += force
            data.xfrc_applied[body, 3:] += torque + np.cross(point - data.xipos[body], force)

    def forward(self, data: Any) -> np.ndarray:
        """Horizontal part (3,) of the base's forward axis in the world."""
        mujoco_package().mj_kinematics(self._scene.compiled, data)
        ahead = data.xmat[self._base].reshape(3, 3)[:, 0]
        return np.asarray(ahead - self._up * (self._up @ ahead))

    def _pushed(self, k: int, data: Any) -> np.ndarray:
        """Force (3,), N, on the base in tick ``k``."""
        force = np.zeros(3)
        if self._push and abs(k / self._timeline.planned - 0.5) < PUSHED / 2:
            level = self.forward(data)
            aside = level if self._scene.robot.base == "planar" else np.cross(self._up, level)
            force += self._push / max(float(np.linalg.norm(aside)), LEAST_LEVEL) * aside
        for impulse in self.impulses:
            force += self._force_of(impulse, k, data)
        return force

    def _force_of(self, impulse: Impulse, k: int, data: Any) -> np.ndarray:
        """Force (3,), N, of an impulse in tick ``k``; its direction is fixed in its first tick."""
        period = self._timeline.period
        first, lasts = round(impulse.time / period), max(1, round(impulse.duration / period))
        if k == first:
            level = self.forward(data)
            along = level / max(float(np.linalg.norm(level)), LEAST_LEVEL)
            turned = np.cos(impulse.direction) * along
            turned = turned + np.sin(impulse.direction) * np.cross(self._up, along)
            self._forces = {**self._forces, impulse: impulse.size / (lasts * period) * turned}
        return self._forces[impulse] if first <= k < first + lasts else np.zeros(3)

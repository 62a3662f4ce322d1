"""Dynamics of the user's own in place of held contacts: solve and check agree, and so does MuJoCo."""

from dataclasses import dataclass, replace

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from typing_extensions import override

import trajopt
from trajopt import Contact, Phase, Problem, Robot, Schedule, terms
from trajopt.errors import SolutionFileError
from trajopt.motion.solution import Solution
from trajopt.terms import PointConstraint, Rows
from trajopt.terrain import Surface

# Time and angle of the motion, s and rad; length of a link, m.
DURATION, ANGLE, LINK = 1.0, -np.pi / 4, 0.4
DOOR = """
<mujoco model="arm_and_door">
 <worldbody>
  <body name="link1" pos="0 0 0.5"><joint name="j1" axis="0 0 1" range="-170 170"/>
   <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="2"/>
   <body name="link2" pos="0.4 0 0"><joint name="j2" axis="0 0 1" range="-150 150"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="1.5"/>
    <site name="hand" pos="0.4 0 0"/></body></body>
  <body name="door" pos="0.75 0.4 0.5"><joint name="hinge" axis="0 0 1" range="-100 0" damping="1"/>
   <geom type="box" pos="0 -0.3 0" size="0.02 0.3 0.4" mass="10"/>
   <site name="handle" pos="-0.05 -0.5 0"/></body>
 </worldbody>
 <actuator><motor joint="j1" ctrlrange="-60 60"/><motor joint="j2" ctrlrange="-40 40"/></actuator>
</mujoco>
"""


@dataclass(frozen=True, kw_only=True)
class Loop(PointConstraint):
    """The hand stays on the handle, with Baumgarte's stabilisation."""

    @override
    def rows(self, context, units):
        hand, handle = context.frame("hand"), context.frame("handle")
        apart = [
            getattr(hand, n)[:2] - getattr(handle, n)[:2] for n in ("acceleration", "velocity", "position")
        ]
        return Rows.create(apart[0] + 20 * apart[1] + 100 * apart[2], 0, 0, 9.81)


@dataclass(frozen=True, kw_only=True)
class OppositeForces(PointConstraint):
    @override
    def rows(self, context, units):
        hand, handle = context.wrenches["hand"], context.wrenches["handle"]
        return Rows.create(ca.vertcat(hand + handle, hand[2]), 0, 0, units.force)


@dataclass(frozen=True, kw_only=True)
class DoorAngle(terms.AtMoment, terms.NodeConstraint):
    @override
    def rows(self, context, units, place):
        return Rows.create(context.q[2], ANGLE, ANGLE, 1.0)


def arm_at(model: pin.Model, hinge: float) -> np.ndarray:
    """The configuration (3,) with the hand on the handle of a door at this angle, rad."""
    data, q = model.createData(), np.array([0.0, 0.0, hinge])
    pin.framesForwardKinematics(model, data, q)
    x, y = data.oMf[model.getFrameId("handle")].translation[:2]
    q[1] = np.arccos(np.clip((x * x + y * y) / (2 * LINK**2) - 1, -1, 1))
    q[0] = np.arctan2(y, x) - np.arctan2(np.sin(q[1]), 1 + np.cos(q[1]))
    return q


@pytest.fixture(scope="module")
def door(tmp_path_factory):
    path = tmp_path_factory.mktemp("door") / "door.xml"
    path.write_text(DOOR)
    contacts = [Contact(frame="hand"), Contact(frame="handle")]
    return Robot.from_mjcf(path, contacts=contacts, reference=np.zeros(3)).with_joint_forces()


@pytest.fixture(scope="module")
def motion(door):
    start = arm_at(door.model, 0.0)
    data = door.model.createData()
    pin.framesForwardKinematics(door.model, data, start)
    place = data.oMf[door.model.getFrameId("hand")].translation.copy()
    grip = {
        n: Surface(point=place, normal=np.array([-1.0, 0, 0]), bilateral=True) for n in ("hand", "handle")
    }
    pull = Phase(name="pull", duration=DURATION, contacts=("hand", "handle"), surfaces=grip)
    problem = Problem(
        name="door",
        robot=door,
        schedule=Schedule((pull,)),
        initial_q=start,
        guess=lambda t: arm_at(door.model, ANGLE * np.clip(t / DURATION, 0, 1)),
        dynamics=(terms.BaseDynamics(), Loop(), OppositeForces()),
        terms=(
            *terms.effort_costs(),
            terms.TorqueLimits(),
            terms.PositionLimits(),
            DoorAngle(),
            terms.TerminalRest(),
        ),
    )
    return trajopt.solve(problem)


def test_solve_and_check_of_own_dynamics_agree(motion, tmp_path):
    motion.save(tmp_path / "door.npz")
    report = trajopt.check(tmp_path / "door.npz")
    assert motion.statistics.status == "solved"
    assert report.ok
    assert report.foot_drift is None
    assert report.local_joints < 5e-3
    assert {entry.term for entry in motion.statistics.terms_between} == {"loop", "opposite_forces"}
    assert any("not judged" in note for note in report.notes)


def test_wrong_forces_of_own_dynamics_fail_the_check(motion):
    report = trajopt.check(replace(motion, f=1.1 * motion.f))
    assert {"base_residual", "local_joints"} <= set(report.failures())


def test_mujoco_opens_the_door_with_the_planned_torques(motion):
    text = DOOR.replace(
        "</worldbody>", '</worldbody><equality><connect site1="hand" site2="handle"/></equality>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = 2e-4, mujoco.mjtIntegrator.mjINT_RK4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.eq_solref[:] = [1e-3, 1]
    data = mujoco.MjData(model)
    data.qpos[:] = motion.q[0]
    for torque in motion.sample(rate=5000).tau[:-1]:
        data.ctrl[:] = torque
        mujoco.mj_step(model, data)
    assert data.qpos[2] == pytest.approx(motion.q[-1, 2], abs=1e-3)


def test_a_file_with_other_dynamics_is_refused(motion, tmp_path):
    path = tmp_path / "door.npz"
    motion.save(path)
    arrays = dict(np.load(path))
    arrays["meta"] = np.array(str(arrays["meta"]).replace('"forced"', '"something"'))
    np.savez(path, **arrays)
    with pytest.raises(SolutionFileError, match="allowed: held, forced, own"):
        Solution.load(path)

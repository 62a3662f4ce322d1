"""Thrusters and springs of MJCF files, against MuJoCo's own forces."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from trajopt.inspection.report import robot_report
from trajopt.robot.robot import Robot

FLYING = """<mujoco><compiler angle="radian"/><worldbody><body name="hull">
<freejoint/><geom size="0.1 0.1 0.03" type="box"/>
<site name="s1" pos="0.1 0.1 0" euler="0.2 0 0"/>
<site name="s2" pos="-0.1 0.1 0"/><site name="s3" pos="0 -0.1 0"/>
<body pos="0 0 -0.05">
<joint name="swing" axis="0 1 0" stiffness="2" springref="0.3" damping="0.1" frictionloss="0.02"/>
<geom size="0.02" fromto="0 0 0 0 0 -0.2" type="capsule"/><site name="tip" pos="0 0 -0.2"/></body>
</body></worldbody>
<actuator><motor name="u1" site="s1" gear="0 0 2 0 0 0.04" ctrllimited="true" ctrlrange="0 5"/>
<motor name="u2" site="s2" gear="0 0 1 0 0 -0.02" ctrllimited="true" ctrlrange="1 5"/>
<motor name="both ways" site="s3" gear="0 0 1 0 0 0" ctrllimited="true" ctrlrange="-1 1"/>
<motor name="skew" site="s3" gear="0 0 1 0.1 0 0" ctrllimited="true" ctrlrange="0 1"/>
<motor name="on a link" site="tip" gear="0 0 1 0 0 0" ctrllimited="true" ctrlrange="0 1"/>
</actuator></mujoco>"""


@pytest.fixture
def flying(tmp_path: Path) -> Path:
    path = tmp_path / "flying.xml"
    path.write_text(FLYING, encoding="utf-8")
    return path


def test_motors_at_sites_of_the_base_are_thrusters(flying: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    robot = Robot.from_mjcf(flying)
    assert [thruster.name for thruster in robot.thrusters] == ["u1", "u2"]
    assert robot.passive == ("swing",)
    assert "thrusters on the base: both ways, skew, on a link" in robot_report(robot).table()
    assert [(t.least, t.most) for t in robot.thrusters] == [(0.0, 10.0), (1.0, 5.0)]
    model = mujoco.MjModel.from_xml_path(str(flying))
    data = mujoco.MjData(model)
    random = np.random.default_rng(0)
    q = pin.randomConfiguration(robot.model, -np.ones(8), np.ones(8))
    data.qpos[:] = np.concatenate([q[:3], q[[6, 3, 4, 5]], q[7:]])
    control = random.uniform(1.0, 5.0, 2)
    data.ctrl[:2] = control
    mujoco.mj_forward(model, data)
    force = robot.actuation.force(np.append(np.zeros(robot.nu - 2), control * [2.0, 1.0]))
    rotation = pin.Quaternion(*q[[6, 3, 4, 5]]).toRotationMatrix()
    assert_allclose(data.qfrc_actuator[:3], rotation @ force[:3], atol=1e-9)
    assert_allclose(data.qfrc_actuator[3:], force[3:], atol=1e-9)


def test_springs_damping_and_dry_friction_of_a_file_count_where_they_are_asked_for(flying: Path) -> None:
    robot = Robot.from_mjcf(flying)
    assert robot.joint_forces == ()
    (force,) = robot.with_joint_forces().joint_forces
    assert (force.joint, force.stiffness, force.rest) == ("swing", 2.0, 0.3)
    assert (force.damping, force.dry_friction) == (0.1, 0.02)

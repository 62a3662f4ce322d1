"""What the extension of Pinocchio is handed is checked before it is an index."""

import pytest

from trajopt import _pinocchio


def joint(parent: int = 0, kind: str = "RX") -> _pinocchio.Joint:
    made = _pinocchio.Joint()
    made.name, made.kind, made.parent, made.mass = "joint", kind, parent, 1.0
    made.rotation = made.inertia = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    made.translation = made.axis = made.lever = [0.0] * 3
    return made


def description(*joints: _pinocchio.Joint, armature: int | None = None) -> _pinocchio.Description:
    made = _pinocchio.Description()
    made.joints, made.gravity = list(joints), [0.0, 0.0, -9.81]
    made.armature = [0.0] * (len(joints) if armature is None else armature)
    return made


def frame(joint: int, wrench_size: int = 0) -> _pinocchio.Frame:
    made = _pinocchio.Frame()
    made.joint, made.wrench_size = joint, wrench_size
    made.rotation, made.translation = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [0.0] * 3
    return made


@pytest.mark.parametrize("number", [-1, 2, 1000, 2**31 - 1])
def test_a_frame_on_a_joint_that_is_not_there_is_refused(number: int) -> None:
    robot, wrong = description(joint()), frame(number)
    for function in (_pinocchio.frame_velocity, _pinocchio.frame_acceleration):
        with pytest.raises(ValueError, match="the joint of a frame is"):
            function(robot, wrong, "world_aligned")
    with pytest.raises(ValueError, match="the joint of a frame is"):
        _pinocchio.frame_placement(robot, wrong)
    with pytest.raises(ValueError, match="the joint of a frame is"):
        _pinocchio.fused(robot, [frame(1), wrong])


def test_a_wrench_of_another_size_and_a_reference_that_is_none_are_refused() -> None:
    with pytest.raises(ValueError, match="wrench size is 4"):
        _pinocchio.fused(description(joint()), [frame(1, wrench_size=4)])
    with pytest.raises(ValueError, match="reference 'here'"):
        _pinocchio.frame_velocity(description(joint()), frame(1), "here")


@pytest.mark.parametrize("parent", [-1, 1, 7])
def test_a_joint_that_does_not_come_after_its_parent_is_refused(parent: int) -> None:
    with pytest.raises(ValueError, match="the parent of joint 'joint' is"):
        _pinocchio.mass_matrix(description(joint(parent)))


@pytest.mark.parametrize("count", [0, 2])
def test_a_wrong_number_of_armatures_is_refused(count: int) -> None:
    with pytest.raises(ValueError, match=f"armature has {count} entries"):
        _pinocchio.mass_matrix(description(joint(), armature=count))

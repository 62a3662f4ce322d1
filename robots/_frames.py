"""Frames that robots add to their descriptions."""

import numpy as np
import pinocchio as pin


def add_frame(model: pin.Model, name: str, link: str, point: tuple[float, float, float]) -> str:
    """Add the frame ``name`` at a point of the frame ``link``, m, with its axes, and return its name."""
    number = model.getFrameId(link)
    entry = model.frames[number]
    placement = entry.placement * pin.SE3(np.eye(3), np.array(point))
    model.addFrame(pin.Frame(name, entry.parentJoint, number, placement, pin.FrameType.OP_FRAME))
    return name

"""The measured trade between speed and accuracy: one problem at many settings, each timed and measured."""

from trajopt.sweep.front import Front, Measured, load_front, packaged_fronts
from trajopt.sweep.setting import Setting

__all__ = ["Front", "Measured", "Setting", "load_front", "packaged_fronts"]

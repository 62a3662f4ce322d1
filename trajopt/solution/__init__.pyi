from .motion import motion_of as motion_of
from .sampled_motion import SampledMotion as SampledMotion
from .solution import Solution as Solution

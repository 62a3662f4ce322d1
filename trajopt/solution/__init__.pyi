from .sampled_motion import SampledMotion as SampledMotion
from .solution import Solution as Solution

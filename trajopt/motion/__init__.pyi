from .configurations import motion_of as motion_of
from .energy_use import cost_of_transport as cost_of_transport
from .energy_use import energy as energy
from .energy_use import integral as integral
from .sampled_motion import SampledMotion as SampledMotion
from .solution import Solution as Solution

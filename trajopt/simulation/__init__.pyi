from .mjcf import write_mjcf as write_mjcf
from .settings import SimulationSettings as SimulationSettings

from .motion import motion_of as motion_of
from .solution import Solution as Solution

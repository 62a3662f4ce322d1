import typing

from . import robot as _robot  # noqa: F401  read by lazy_loader
from .certify.check import check as check
from .errors import InputError as InputError
from .errors import TrajoptError as TrajoptError
from .export.writing import export_motion as export_motion
from .motion.configurations import motion_of as motion_of
from .motion.solution import Solution as Solution
from .problem.catalogue import load as load
from .problem.problem import Problem as Problem
from .robot.contact import Contact as Contact
from .robot.robot import Robot as Robot
from .schedule.moment import Moment as Moment
from .schedule.moment import end_of as end_of
from .schedule.moment import middle_of as middle_of
from .schedule.moment import start_of as start_of
from .schedule.schedule import Phase as Phase
from .schedule.schedule import Schedule as Schedule
from .simulation.simulate import simulate as simulate
from .solving.continuation import continuation as continuation
from .solving.diagnosis.diagnose import diagnose as diagnose
from .solving.graded import solve as solve
from .solving.ladder import solve_ladder as solve_ladder
from .study.batch.batch import batch as batch
from .study.batch.batch import dataset as dataset
from .study.discovery.search import discover as discover
from .terrain.flat import FlatGround as FlatGround
from .view.replay.show import replay as replay

class _CallableRoom:
    """The package `trajopt.robot`, which is also the function that loads a robot."""

    def __call__(self, name: str) -> Robot: ...
    def __getattr__(self, name: str) -> typing.Any: ...

robot: _CallableRoom
__version__: str

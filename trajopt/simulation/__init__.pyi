from .drive_report import DriveReport as DriveReport
from .lockstep import DrivenMotion as DrivenMotion
from .lockstep import drive as drive
from .mjcf import write_mjcf as write_mjcf
from .push import PushReport as PushReport
from .push import largest_pushes as largest_pushes
from .settings import Impulse as Impulse
from .settings import SimulationSettings as SimulationSettings

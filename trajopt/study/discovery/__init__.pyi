from .goal import Destination as Destination
from .goal import cycle_of as cycle_of
from .goal import task_to as task_to
from .modes import ModeSequence as ModeSequence
from .records import Discovery as Discovery
from .relaxation import relaxed_motion as relaxed_motion
from .search import discover as discover
from .task import ContactTask as ContactTask

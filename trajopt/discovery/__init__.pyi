from .discover import Discovery as Discovery
from .discover import discover as discover
from .goal import Goal as Goal
from .goal import problem_of as problem_of
from .modes import ModeSequence as ModeSequence
from .relaxation import relaxed_motion as relaxed_motion
from .task import ContactTask as ContactTask

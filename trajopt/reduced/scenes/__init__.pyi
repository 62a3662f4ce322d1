from .goals import scene as scene
from .report import Decision as Decision
from .report import ProblemSize as ProblemSize
from .report import SceneReport as SceneReport
from .smallest_scene import SmallestScene as SmallestScene
from .smallest_scene import size_of as size_of
from .smallest_scene import smallest as smallest

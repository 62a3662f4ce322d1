from .goals import scene as scene
from .report import Decision as Decision
from .report import ProblemSize as ProblemSize
from .report import SceneReport as SceneReport
from .smallest import Scene as Scene
from .smallest import size_of as size_of
from .smallest import smallest as smallest

from .notebook import plots as plots
from .notebook import show as show
from .plotting import write_plots as write_plots
from .watching.viewer import Viewer as Viewer

from .notebook import plots as plots
from .notebook import show as show

from .comparison import Comparison as Comparison
from .comparison import compare as compare
from .measures import Accuracy as Accuracy
from .measures import PhaseAccuracy as PhaseAccuracy
from .measures import interval_errors as interval_errors
from .measures import measure as measure

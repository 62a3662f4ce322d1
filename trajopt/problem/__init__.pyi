from .catalogue import families as families
from .catalogue import load as load
from .family import Choice as Choice
from .family import Family as Family
from .family import Parameter as Parameter
from .family import choose as choose
from .periodicity import Periodicity as Periodicity
from .problem import Problem as Problem

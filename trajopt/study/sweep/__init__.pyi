from .front import load_front as load_front
from .front import packaged_fronts as packaged_fronts

from .base_joint import ORDERS as ORDERS
from .manifold import Coordinates as Coordinates
from .model_quantities import STANDARD_GRAVITY as STANDARD_GRAVITY
from .model_quantities import contact_jacobian as contact_jacobian
from .model_quantities import gravity_of as gravity_of

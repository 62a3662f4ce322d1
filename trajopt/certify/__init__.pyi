from .energy import cost_of_transport as cost_of_transport
from .energy import energy as energy

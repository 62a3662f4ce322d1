from .contact.contact_dynamics import ContactMotion as ContactMotion
from .contact.contact_dynamics import InverseDynamics as InverseDynamics
from .contact.contact_dynamics import actuated_force as actuated_force
from .contact.contact_dynamics import forward_dynamics as forward_dynamics
from .contact.contact_dynamics import inverse_dynamics as inverse_dynamics
from .contact.contact_set import ContactSet as ContactSet
from .contact.friction import cone_margins as cone_margins
from .contact.impact import impact as impact

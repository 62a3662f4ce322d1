from .exported_motion import ExportedMotion as ExportedMotion
from .exported_motion import sample_cycles as sample_cycles
from .writing import export_motion as export_motion

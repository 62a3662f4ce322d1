"""Model predictive control: commands to horizons, horizons to motions, motions to torques.

`Controller.step` and `ArmController.step` need no simulator; `trajopt.simulation.drive` and the command
``trajopt drive`` run them in one.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""A scene, a controller and events give a record in MuJoCo: of plans, pushes and drives."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

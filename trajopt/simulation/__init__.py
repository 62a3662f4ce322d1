"""Plans, pushes and drives run in MuJoCo: a scene, a controller and events produce a record."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

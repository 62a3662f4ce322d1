"""Many solves: batches of cases, suites of problems, sweeps over settings, discovery of schedules."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Studies: success, clearance and time against one number of an experiment; each value a run of its own."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Evaluation: success rates with honest intervals, failures by cause, arrival times against the expert's."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

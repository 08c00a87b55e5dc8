"""Experiments: the settings of all stages in one file, read, checked as a whole, and told apart by hashes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Sweeps: trials of one experiment, identified by the hash of what they are, resumable, sharing equal stages."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

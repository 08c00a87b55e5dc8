"""The scene: obstacles, target, torso envelope, start distribution and exact clearance."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

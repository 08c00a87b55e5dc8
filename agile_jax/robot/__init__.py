"""The robot: its constants with sources, kinematics in JAX, and the MuJoCo model of the robot in its scene."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The policy: a velocity field s -> s', what a robot needs of it at run time.

Only the settings are imported with the package; the rest loads JAX when first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The training: from the expert's labels to a policy, and the learner's own test of it.

Only the settings are imported with the package; the rest loads JAX when first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

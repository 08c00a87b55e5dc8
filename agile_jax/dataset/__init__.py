"""The dataset: verified trajectories of the expert in immutable, checked shards, split by trajectory. Loads no JAX."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

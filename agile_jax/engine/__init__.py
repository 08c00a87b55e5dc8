"""The work engine: maps a module-level function over independent tasks, here, over local processes or over a cluster.

A task that raises, whose worker dies again and again, or that exceeds its time limit again and again, becomes a
`TaskFailure`; all others are finished. A worker that dies once costs nothing: it is replaced and its task runs again,
so tasks must be idempotent. Workers are processes of one thread each; they hold no accelerator, because nothing that
they import for the expert loads JAX (episodes do, evaluation/episodes.py).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

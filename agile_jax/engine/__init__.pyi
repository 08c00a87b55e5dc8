"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .dask_engine import DaskEngine as DaskEngine
from .opening import THREADS as THREADS, check_engine as check_engine, open_engine as open_engine
from .tasks import (
    Engine as Engine,
    InlineEngine as InlineEngine,
    TaskFailure as TaskFailure,
    TasksFailedError as TasksFailedError,
    describe as describe,
)

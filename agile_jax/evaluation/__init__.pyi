"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .backend import check_backend as check_backend, check_devices as check_devices
from .comparison import compare as compare
from .settings import EvaluationSettings as EvaluationSettings
from .single import rollout_one as rollout_one
from .stage import evaluate as evaluate
from .statistics import mcnemar_p_value as mcnemar_p_value, wilson_interval as wilson_interval
from .traces import load_traces as load_traces

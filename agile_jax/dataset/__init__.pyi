"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .dataset import (
    SPLITS as SPLITS,
    Dataset as Dataset,
    Split as Split,
    labels as labels,
    labels_to as labels_to,
    load as load,
    samples as samples,
    split_mask as split_mask,
)
from .expert_time import ExpertTimes as ExpertTimes, expert_times as expert_times, time_limit as time_limit
from .generate import generate as generate, make_labels as make_labels
from .queries import Answers as Answers, ask as ask
from .settings import DatasetSettings as DatasetSettings
from .starts import rejected_shares as rejected_shares, unseen_starts as unseen_starts
from .write import write as write

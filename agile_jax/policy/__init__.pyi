"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .braking import braking_law as braking_law
from .export import Exported as Exported, export_policy as export_policy
from .feedback import FeedbackLaw as FeedbackLaw
from .field import Field as Field, PlainField as PlainField, ResidualField as ResidualField
from .kinds import make_policy as make_policy
from .network import (
    Normalization as Normalization,
    PolicyParameters as PolicyParameters,
    parameter_count as parameter_count,
)
from .policy import Encoding as Encoding, Policy as Policy, TrainedPolicy as TrainedPolicy
from .settings import PolicySettings as PolicySettings

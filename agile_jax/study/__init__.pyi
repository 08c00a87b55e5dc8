"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .rows import make_rows as make_rows, sentences as sentences, table as table
from .run import list_values as list_values, run_study as run_study, study_settings as study_settings
from .settings import StudySettings as StudySettings

"""An experiment: one question, one file, all settings of all stages.

`load_experiment` reads a TOML file (with `extends`), applies overrides and validates everything at once. On which of
the settings a result depends stands in store/artefact.py.
"""

import pathlib
import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import tomli_w
from pydantic import Field, field_validator, model_validator

from agile_jax.control.settings import AnyControl, ControlSettings
from agile_jax.dataset.settings import DatasetSettings
from agile_jax.evaluation.settings import EvaluationSettings
from agile_jax.experiment.check import Contradiction, ContradictionsError, check
from agile_jax.experiment.crouch import with_crouch
from agile_jax.experiment.file import Table, origin, override, read_table
from agile_jax.experiment.moved import moved
from agile_jax.experiment.robot_path import resolve_robot_paths
from agile_jax.experiment.validation import validate
from agile_jax.expert.settings import AnyExpert, ExpertSettings
from agile_jax.files import hash_json
from agile_jax.plugins import load
from agile_jax.policy.settings import AnyPolicy, PolicySettings
from agile_jax.report.settings import ReportSettings
from agile_jax.robot.settings import PlantSettings, RobotSettings, SensorSettings
from agile_jax.scene.settings import SceneSettings
from agile_jax.settings import BadInput, Settings
from agile_jax.study.settings import StudySettings
from agile_jax.sweep.settings import SweepSettings
from agile_jax.training.settings import AggregationSettings, KinematicTestSettings, TrainingSettings

STAGES = ("dataset", "training", "evaluation", "report")


class Experiment(Settings):
    """The settings of every stage. A file needs only a name: the defaults are the paper's scene without its table."""

    name: str
    """Name of the run directory: letters, digits, - and _."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of everything random."""
    scene: SceneSettings = SceneSettings()
    """The world of the plan: target, obstacles, torso, starts, bounds."""
    expert: AnyExpert = ExpertSettings()
    """The optimal control problem and how it is solved."""
    dataset: DatasetSettings = DatasetSettings()
    """The labels, and which samples the policy sees of them."""
    policy: AnyPolicy = PolicySettings()
    """What the policy is: kind and network."""
    training: TrainingSettings = TrainingSettings()
    """How the network is fitted."""
    kinematic_test: KinematicTestSettings = KinematicTestSettings()
    """The kinematic test of the policy."""
    aggregation: AggregationSettings = AggregationSettings()
    """Rounds of dataset aggregation."""
    robot: RobotSettings = RobotSettings()
    """Which robot."""
    plant: PlantSettings = PlantSettings()
    """How the simulated robot differs from what the controller is told of it."""
    sensors: SensorSettings = SensorSettings()
    """What the robot senses of itself, where its state is estimated."""
    control: AnyControl = ControlSettings()
    """The whole-body controller: gait, MPC, swing legs."""
    evaluation: EvaluationSettings = EvaluationSettings()
    """Episodes of the closed loop."""
    report: ReportSettings = ReportSettings()
    """Figures and video."""
    sweep: SweepSettings | None = None
    """What `agile sweep` varies."""
    study: StudySettings | None = None
    """What `agile study` varies."""

    @field_validator("name")
    @classmethod
    def _name_is_a_slug(cls, name: str) -> str:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", name):
            raise ValueError(
                "must be 1 to 64 letters, digits, - or _, and begin with a letter or digit: it names a folder"
            )
        return name

    @model_validator(mode="after")
    def _stages_agree(self) -> "Experiment":
        fastest, found = max(self.expert.velocity[:2]), list[Contradiction]()
        try:
            object.__setattr__(self, "scene", with_crouch(self.scene, fastest, self.robot, self.control))
        except ContradictionsError as error:
            found = error.found
        check(self, found)
        return self


def load_experiment(
    path: pathlib.Path | str, overrides: Mapping[str, object] | None = None, plugins: Iterable[str] = ()
) -> Experiment:
    """Read, merge, override and validate an experiment file.

    Args:
        path: a TOML file.
        overrides: values by dotted key, for example {"training.learning_rate": 0.1}.
        plugins: modules or Python files that are loaded before, for kinds of their own (docs/extending.md).

    Raises:
        BadInput: with every error, one a line: file, dotted key, value, what is allowed, nearest valid name.
    """
    load(plugins)
    return _make(resolve_robot_paths(override(read_table(pathlib.Path(path)), overrides or {})))


def with_overrides(experiment: Experiment, overrides: Mapping[str, object], source: str) -> Experiment:
    """The experiment with other values by dotted key, validated as a file is; `source` names them in messages."""
    table = Table(experiment.model_dump(mode="json"), {}, source)
    return _make(override(table, overrides, source))


def to_toml(experiment: Experiment) -> str:
    """The experiment as a file that loads to the same experiment, without the keys that have no value."""
    return tomli_w.dumps(experiment.model_dump(mode="json", exclude_none=True))


def experiment_hash(experiment: Experiment) -> str:
    """The sha256 of all settings but the name, the sweep and the study, which change no result."""
    return hash_json(experiment.model_dump(mode="json", exclude={"name", "sweep", "study"}))


def json_schema() -> dict[str, Any]:
    """The JSON schema of experiment files, for editors; with what each setting means."""
    schema = Experiment.model_json_schema()
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "another experiment file, relative to this one, whose values hold where this file sets none",
    }
    return schema


def _make(table: Table) -> Experiment:
    if old := [f"{origin(table, where)}: {'.'.join(where)}: {what}" for where, what in moved(table.values)]:
        raise BadInput("\n".join(old))
    return validate(Experiment, table.values, lambda where: origin(table, where))

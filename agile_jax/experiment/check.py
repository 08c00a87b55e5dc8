"""What must hold across the stages of an experiment: checked here alone, once every setting is valid by itself.

Settings are data. What takes geometry or a robot's model to judge is asked of the packages that know it.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from agile_jax.dataset.starts import draw_start, unseen_starts
from agile_jax.experiment.file import KeyPath
from agile_jax.expert.feasible_poses import pose_errors
from agile_jax.robot.settings import OWN
from agile_jax.scene.scene import make_scene, planar_scene
from agile_jax.settings import BadInput

if TYPE_CHECKING:
    from agile_jax.experiment.experiment import Experiment


class Contradiction(NamedTuple):
    """Settings of one stage that another stage, or the scene, cannot do with."""

    key: KeyPath  # that is to be changed: tells the file
    text: str  # names key, value and what is allowed


class ContradictionsError(ValueError):
    """All contradictions of an experiment."""

    def __init__(self, found: list[Contradiction]):
        super().__init__("\n".join(one.text for one in found))
        self.found = found


def check(experiment: "Experiment", found: list[Contradiction]) -> None:
    """Raise ContradictionsError with what has been `found` already, and all else that is wrong across stages."""
    found = [
        *found,
        *_poses(experiment),
        *_robot(experiment),
        *_plant(experiment),
        *_policy(experiment),
        *_sweep(experiment),
    ]
    if found:
        raise ContradictionsError(found)


def _poses(experiment: "Experiment") -> Iterator[Contradiction]:
    """Targets at which no plan can end, and distributions without a start from which one can begin."""
    scene, expert, dataset = make_scene(experiment.scene), experiment.expert, experiment.dataset
    if expert.dimensions == "2d":
        scene = planar_scene(scene)
    errors = pose_errors(scene, expert, scene.target, "scene.target")
    yield from (Contradiction(("scene", "target"), error) for error in errors)
    for i, target in enumerate(dataset.targets):
        for error in pose_errors(scene, expert, np.array(target), f"dataset.targets[{i}]"):
            yield Contradiction(("dataset", "targets"), error)
    if errors:
        return
    try:
        unseen_starts(experiment.scene, expert, 1, (0,))
    except BadInput as error:
        yield Contradiction(("scene", "start"), str(error))
    if dataset.starts == "wide":
        try:
            draw_start(make_scene(experiment.scene), experiment.scene, expert, dataset, experiment.seed, 0)
        except BadInput as error:
            yield Contradiction(("dataset", "starts"), str(error))


def _robot(experiment: "Experiment") -> Iterator[Contradiction]:
    """Another robot's files, and the envelope that plans keep clear for it."""
    if experiment.robot.name == OWN:
        return
    from agile_jax.robot.envelope import check_envelope  # loads mujoco

    try:
        check_envelope(experiment.scene.torso_half_size, experiment.robot)
    except BadInput as error:
        yield Contradiction(("robot", "name"), str(error))


def _plant(experiment: "Experiment") -> Iterator[Contradiction]:
    """Robots that MJX, which has one model and ideal motors, cannot simulate."""
    plant, backend = experiment.plant, experiment.evaluation.backend
    if backend in ("mujoco", "pybullet"):
        return
    for name, usual in (("delay", 0), ("no_load_speed", None), ("push_impulse", 0)):
        if getattr(plant, name) != usual:
            yield Contradiction(("plant", name), f'plant.{name} needs evaluation.backend = "mujoco", not "{backend}"')
    values = {name: value for name, value in plant if name != "com_shift"} | {"com_shift": plant.com_shift}
    for name, value in values.items():
        if any(isinstance(one, tuple) for one in (value if name == "com_shift" else [value])):
            yield Contradiction(
                ("plant", name),
                f'plant.{name} = {value} is a range, which needs evaluation.backend = "mujoco", not "{backend}"',
            )


def _policy(experiment: "Experiment") -> Iterator[Contradiction]:
    """What kinds of policies can be trained on, and can ask for."""
    policy, expert, dataset = experiment.policy, experiment.expert, experiment.dataset
    filtered = policy.kind != "plain" and policy.field_filter and experiment.scene.obstacles
    if filtered and policy.filter_margin >= expert.clearance_margin:
        yield Contradiction(
            ("policy", "filter_margin"),
            f"policy.filter_margin = {policy.filter_margin} must be below expert.clearance_margin = "
            f"{expert.clearance_margin}, or the filter would stop the field where the labels pass; "
            "lower it, or set policy.field_filter = false",
        )
    rounds = experiment.aggregation.rounds
    if rounds and (policy.kind == "feedback" or expert.initial_velocity != "free"):
        yield Contradiction(
            ("aggregation", "rounds"),
            f"aggregation.rounds = {rounds} asks the expert for the best velocity at a pose, which only policies that "
            'learn it can use: it needs expert.initial_velocity = "free" and policy.kind = "plain" or "residual"; '
            "set aggregation.rounds = 0",
        )
    if policy.kind == "feedback" and expert.initial_velocity != "rest":
        yield Contradiction(
            ("policy", "kind"),
            'policy.kind = "feedback" learns how to speed up, too: it needs expert.initial_velocity = "rest"',
        )
    if policy.kind == "feedback" and dataset.split_by != "trajectory":
        yield Contradiction(
            ("dataset", "split_by"), 'dataset.split_by = "sample" is not for policy.kind = "feedback"; use "trajectory"'
        )
    for key, value, usual in (
        ("dataset.label_kind", dataset.label_kind, "velocity"),
        ("training.output_units", experiment.training.output_units, "si"),
    ):
        if policy.kind != "plain" and value != usual:
            yield Contradiction(
                tuple(key.split(".")),
                f'{key} = "{value}" is for policy.kind = "plain"; "{policy.kind}" sets its own units; use "{usual}"',
            )


def _sweep(experiment: "Experiment") -> Iterator[Contradiction]:
    """A metric that no trial can have."""
    sweep = experiment.sweep
    if sweep is None:
        return
    listed = tuple(point["evaluation.backend"] for point in sweep.points if "evaluation.backend" in point)
    backends = sweep.space.get("evaluation.backend", (experiment.evaluation.backend, *listed))
    stage, name, *_ = sweep.metric.split(".")
    if stage == "evaluation" and name not in backends:
        yield Contradiction(
            ("sweep", "metric"),
            f"sweep.metric = {sweep.metric!r}: no trial has an evaluation by {name!r}; evaluation.backend gives "
            f"{', '.join(map(str, backends))}",
        )

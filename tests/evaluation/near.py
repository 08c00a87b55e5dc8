"""An evaluation that takes seconds: straight to a target 0.3 m ahead, from starts that differ a little."""

from agile_jax.experiment import Experiment


def near(
    control: dict | None = None,
    robot: dict | None = None,
    scene: dict | None = None,
    plant: dict | None = None,
    **evaluation,
) -> Experiment:
    """The experiment, with other settings of its sections."""
    start = {"std": [0.05, 0.05, 0.01, 0.0], "mean": [0.5, 0, 0.28, 0]}
    return Experiment.model_validate(
        {
            "name": "near",
            "expert": {"nodes": 20},
            "scene": {"target": [0.8, 0.0, 0.28, 0.0], "start": start} | (scene or {}),
            "control": control or {},
            "robot": robot or {},
            "plant": plant or {},
            "evaluation": {"planner": "straight", "episodes": 4, "batch": 2, "traced": 2} | evaluation,
        }
    )

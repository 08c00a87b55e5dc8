"""Settings of the evaluation."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from agile_jax.settings import Count, Positive, Settings


class EvaluationSettings(Settings):
    """Closed-loop episodes from starts of the scene's distribution that no training has seen.

    The planner is what the controller follows. policy: the learned field. replan: the expert, asked again every
    `replan_interval` from the measured pose. open_loop: the expert's path from the start. open_loop_2d: the same of the
    planner that knows the plane only. straight: the braking law towards the target, blind to obstacles.
    """

    episodes: Count = 64
    # C MuJoCo in threads; all in one compiled scan, in MJX or in MuJoCo Warp (NVIDIA GPUs, mujoco-mjx[warp]).
    backend: Literal["mujoco", "mjx", "mjx-warp"] = "mujoco"
    planner: Literal["policy", "replan", "open_loop", "open_loop_2d", "straight"] = "policy"
    replan_interval: Positive = 0.1  # of the planner "replan" [s]
    # here: in this process; workers: in the engine's, one core each, faster from some hundred episodes on.
    where: Literal["here", "workers"] = "here"
    batch: Count = 64  # episodes simulated at once; does not change their results
    devices: Count = 1  # of JAX, that share the batch in MJX; does not change their results
    seed: Annotated[int, Field(ge=0)] = 0  # of the starts, beside the experiment's own
    traced: Annotated[int, Field(ge=0)] = 8  # episodes recorded for figures and videos

    @model_validator(mode="after")
    def _planner_runs_in_the_backend(self) -> "EvaluationSettings":
        if self.backend != "mujoco" and self.planner not in ("policy", "straight"):
            raise ValueError(
                f'planner = "{self.planner}" asks the expert on the host, which backend = "{self.backend}" cannot; '
                'use "mujoco"'
            )
        return self

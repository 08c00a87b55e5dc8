"""Settings of the evaluation."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from agile_jax.settings import Count, Positive, Settings


class PhysicsSettings(Settings):
    """How C MuJoCo steps, and PyBullet."""

    substeps: Count | None = None
    """Steps of the physics in each `control.control_dt`; without a value 1, in PyBullet 2."""
    integrator: Literal["euler", "implicitfast", "implicit", "rk4"] = "euler"
    """Of C MuJoCo. All but rk4 take the damping of the joints implicitly."""
    cone: Literal["pyramidal", "elliptic"] = "pyramidal"
    """Cone of the ground's friction in C MuJoCo."""
    rotor_reaction: bool = True
    """In PyBullet rotors react on the links that carry them, as real ones do; without it, they do not, as in MuJoCo."""


class EvaluationSettings(Settings):
    """Closed-loop episodes from starts of the scene's distribution that no training has seen."""

    episodes: Count = 64
    """Number of episodes, each from a start of its own."""
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")] | None = None
    """Name of this evaluation in its run directory, for `agile compare RUN_DIR:NAME`; changes no result."""
    backend: Literal["mujoco", "mjx", "mjx-warp", "pybullet"] = "mujoco"
    """Physics. mujoco: C MuJoCo in threads. mjx, mjx-warp: all robots in one compiled scan, in MJX or in MuJoCo Warp
    (NVIDIA GPUs, mujoco-mjx[warp]). pybullet: another engine, the paper's (agile_jax[pybullet]).
    """
    physics: PhysicsSettings = PhysicsSettings()
    """Steps, integrator and friction of C MuJoCo and PyBullet."""
    planner: Literal["policy", "replan", "open_loop", "open_loop_2d", "straight"] = "policy"
    """What the controller follows. policy: the learned field. replan: the expert, asked again and again from the
    measured pose. open_loop: the expert's path from the start. open_loop_2d: that of the planner that knows the plane
    only. straight: the braking law towards the target, blind to obstacles.
    """
    replan_interval: Positive = 0.1
    """Time between two answers of the planner "replan" [s]."""
    where: Literal["here", "workers"] = "here"
    """here: in this process. workers: in the engine's, one core each; faster from some hundred episodes on."""
    batch: Count = 64
    """Number of episodes simulated at once; does not change their results."""
    threads: Count | None = None
    """Number of threads of C MuJoCo, all cores of this process when there is no value; does not change results."""
    devices: Count = 1
    """Number of JAX's devices that share the batch in MJX; does not change the results."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the starts, beside the experiment's own."""
    traced: Annotated[int, Field(ge=0)] = 8
    """Number of episodes recorded for figures and videos."""

    @property
    def substeps(self) -> int:
        """Steps of the physics in each `control.control_dt`."""
        return self.physics.substeps or (2 if self.backend == "pybullet" else 1)

    @model_validator(mode="after")
    def _backend_knows_the_physics(self) -> "EvaluationSettings":
        default = PhysicsSettings()
        for name, *backends in (
            ("substeps", "mujoco", "pybullet"),
            ("integrator", "mujoco"),
            ("cone", "mujoco"),
            ("rotor_reaction", "pybullet"),
        ):
            value = getattr(self.physics, name)
            if value != getattr(default, name) and self.backend not in backends:
                raise ValueError(
                    f'physics.{name} = {value!r} has no effect with backend = "{self.backend}"; leave it out, or use '
                    + " or ".join(f'"{one}"' for one in backends)
                )
        return self

    @model_validator(mode="after")
    def _planner_runs_in_the_backend(self) -> "EvaluationSettings":
        if self.backend in ("mjx", "mjx-warp") and self.planner not in ("policy", "straight"):
            raise ValueError(
                f'planner = "{self.planner}" asks the expert on the host, which backend = "{self.backend}" cannot; '
                'use "mujoco" or "pybullet"'
            )
        return self

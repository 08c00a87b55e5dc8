"""Solving one route by the general program, up a ladder of attempts until one is verified.

A label that all rungs fail on is kept as failed, with the cause of each. The rung that a label came from is part of
it, so that what the ladder rescues is counted.
"""

from typing import Any, NamedTuple

import numpy as np

from agile_jax.expert.profile import Profile
from agile_jax.expert.regions import FreeSpace
from agile_jax.expert.routes import Route, branch_name
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Residuals, Trajectory
from agile_jax.expert.verify import rejection, verify
from agile_jax.scene import POSE_SIZE, Scene

FEWEST_INTERVALS = 4  # in a phase
REFINEMENTS = 1  # of the time grid
NEARLY = 1e-3  # relative excess over the lower bound up to which the slowest axis' switches are where they are at it
SETTLED = 1e-6  # [s] of the objective, the least gain that is worth another refinement
CERTIFIED = "certified"  # the method of labels from the fast path


class Rung(NamedTuple):
    """One way to solve a route."""

    name: str
    solver: str
    slowness: float  # of the guess


RUNGS = (
    Rung("fatrop", "fatrop", 1.0),
    Rung("fatrop-careful", "fatrop-careful", 1.0),
    Rung("fatrop-other-guess", "fatrop", 2.0),
    Rung("ipopt", "ipopt", 1.0),
    Rung("ipopt-other-guess", "ipopt", 2.0),
)


class Candidate(NamedTuple):
    """A verified trajectory along one route."""

    branch: str
    detours: int
    trajectory: Trajectory
    objective: float
    residuals: Residuals
    method: str  # rung, or "certified"


class Ladder:
    """The general programs for one torso, each built when it is first needed. They hold no state between calls."""

    def __init__(self, torso_half_size: np.ndarray, settings: ExpertSettings) -> None:
        self._torso_half_size, self._settings = torso_half_size, settings
        self._programs: dict[tuple[int, str, str, int], Any] = {}

    def solve(
        self,
        scene: Scene,
        space: FreeSpace,
        route: Route,
        start: np.ndarray,
        initial_velocity: str,
        profile: Profile | None,
        first: str = "fatrop",
        guess: int = 0,
    ) -> Candidate | str:
        """The verified solution along a route, or why there is none.

        Args:
            scene: with the target.
            space: the regions of the route.
            route: from `start` to the target.
            start: pose, shape (4,).
            initial_velocity: "rest" or "free".
            profile: of the slowest axis.
            first: name of the rung to begin with; those before it are tried last.
            guess: 0 for the usual initial guess; other numbers disturb it, each in its own way.
        """
        from agile_jax.expert.arguments import disturbed, make_arguments
        from agile_jax.expert.transcription import solve_program

        settings = self._settings
        phases = len(route.regions)
        if settings.nodes < FEWEST_INTERVALS * phases:
            return f"{settings.nodes} nodes are too few for {phases} phases"
        rows = len(route.regions[0].faces) if space.exact else 0
        begin = [rung.name for rung in RUNGS].index(first)
        causes = []
        for rung in RUNGS[begin:] + RUNGS[:begin]:
            program = self._program(phases, initial_velocity, rung.solver, rows)
            best: Candidate | None = None
            boundaries = None
            for _ in range(1 + REFINEMENTS):
                arguments = make_arguments(
                    route, program, start, scene.target, settings, profile, rung.slowness, boundaries
                )
                if guess:
                    arguments = disturbed(arguments, guess)
                trajectory, objective, success, status = solve_program(program, arguments)
                residuals = verify(scene, settings, trajectory, start, initial_velocity)
                cause = rejection(residuals)
                if not success or cause:
                    causes.append(f"{rung.name}: " + (cause if success else f"status {status}"))
                    break
                gained = np.inf if best is None else best.objective - objective
                if gained > 0:
                    branch = branch_name(space, route, trajectory.states[:, :POSE_SIZE])
                    best = Candidate(branch, route.detours, trajectory, objective, residuals, rung.name)
                attained = profile is not None and trajectory.times[-1] <= profile.duration * (1 + NEARLY)
                if not route.detours or not attained or gained < SETTLED:
                    break
                # The profile told nothing about these boundaries; now that they are known, its switches can be nodes.
                boundaries = trajectory.times[np.cumsum([0, *program.intervals])]
            if best is not None:
                return best
        return "; ".join(causes)

    def _program(self, phases: int, initial_velocity: str, solver: str, obstacles: int) -> Any:
        # CasADi is loaded by the first solve: settings, verification and free space are read without it.
        from agile_jax.expert.transcription import build_program

        key = (phases, initial_velocity, solver, obstacles)
        if key not in self._programs:
            self._programs[key] = build_program(
                phases, initial_velocity, self._settings, solver, obstacles, self._torso_half_size
            )
        return self._programs[key]

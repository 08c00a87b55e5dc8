"""Solving one route by the general program, up a ladder of attempts until one is verified.

A label that all rungs fail on is kept as failed, with the cause of each. The rung that a label came from is part of
it, so that what the ladder rescues is counted.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from agile_jax.expert.search.branches import branch_name
from agile_jax.expert.search.profile import Profile
from agile_jax.expert.search.routes import Route
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Residuals, Trajectory
from agile_jax.expert.space.regions import FreeSpace, planning_margin
from agile_jax.expert.verify import rejection, verify
from agile_jax.scene import POSE_SIZE, Scene

FEWEST_INTERVALS = 4  # in a phase around no edge
NEARLY = 1e-3  # relative excess over the lower bound up to which the slowest axis' switches are where they are at it
MOST_PROGRAMS = 12  # kept: each takes 10 to 20 MB, so that they bound the memory of a worker
NOISES = 1000  # sets the disturbances of the rungs apart from those that are asked for
SMOOTH = 10  # factor on the weight of the effort, from which a route with detours is approached
HOPELESS = 1e-2  # relative; the step from the smoother problem to the label changes the objective by about 0.1 %
VIOLATION = "_violation"  # in the cause of what leaves its bounds, or the margin, at or between nodes
CERTIFIED = "certified"  # the method of labels from the fast path


class Rung(NamedTuple):
    """One way to solve a route."""

    name: str
    solver: str
    slowness: float  # of the guess
    noise: int = 0  # that disturbs the guess, each number in its own way; 0: none


RUNGS = (
    Rung("fatrop", "fatrop", 1.0),
    Rung("fatrop-careful", "fatrop-careful", 1.0),
    Rung("fatrop-other-guess", "fatrop", 2.0),
    Rung("fatrop-disturbed", "fatrop-careful", 1.0, 1),
    Rung("fatrop-disturbed-again", "fatrop-careful", 1.0, 2),
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
        self._programs: dict[tuple[tuple[Any, ...], str, str, bool], Any] = {}

    def solve(
        self,
        world: Scene,
        scene: Scene,
        space: FreeSpace,
        route: Route,
        start: np.ndarray,
        initial_velocity: str,
        profile: Profile | None,
        first: str = "fatrop",
        guess: int = 0,
        rival: float = np.inf,
    ) -> Candidate | str:
        """The verified solution along a route, or why there is none.

        Args:
            world: all obstacles, for the branch's name.
            scene: those that the route heeds, and the target.
            space: the regions of the route.
            route: from `start` to the target.
            start: pose, shape (4,).
            initial_velocity: "rest" or "free".
            profile: of the slowest axis.
            first: name of the rung to begin with; those before it are tried last.
            guess: 0 for the usual initial guess; other numbers disturb it, each in its own way.
            rival: an objective that is already had; a route with detours that stays well above it is given up.
        """
        from agile_jax.expert.programs.initial_guess import disturbed, faces_with_rows, make_arguments, near
        from agile_jax.expert.programs.transcription import Phase, Solved, solve_program, split_nodes

        settings = self._settings
        phases = tuple(Phase(len(region.edge) > 0, len(faces_with_rows(region))) for region in route.regions)
        if split_nodes(settings.nodes, phases)[-1] < FEWEST_INTERVALS:  # the last phase is around no edge
            return f"{settings.nodes} nodes are too few for {len(phases)} phases"
        causes: list[str] = []

        def climb(
            rungs: Sequence[Rung], weight: float, previous: Solved | None = None, boundaries: np.ndarray | None = None
        ) -> tuple[Solved, Residuals, Rung] | None:
            """The first rung's solution that is good, from the guess or from another solution."""
            for rung in rungs:
                program = self._program(phases, initial_velocity, rung.solver, space.exact)
                arguments = make_arguments(
                    route,
                    space.margin,
                    program,
                    start,
                    scene.target,
                    settings,
                    weight,
                    profile,
                    rung.slowness,
                    boundaries,
                )
                if previous is not None:
                    arguments = near(arguments, program, previous.variables)
                elif guess or rung.noise:
                    arguments = disturbed(arguments, guess + NOISES * rung.noise)
                solved = solve_program(program, arguments)
                residuals = verify(scene, settings, solved.trajectory, start, initial_velocity)
                # What only leads to the label need not keep the margin between nodes.
                cause = rejection(residuals) if weight == settings.effort_weight else ""
                if solved.success and not cause:
                    return solved, residuals, rung
                causes.append(f"{rung.name}: " + (cause if solved.success else f"status {solved.status}"))
                if solved.success and VIOLATION in cause and space.margin < planning_margin(settings):
                    break  # the other rungs would not do better, a larger reserve will
            return None

        begin = [rung.name for rung in RUNGS].index(first)
        rungs = RUNGS[begin:] + RUNGS[:begin]
        used: list[Rung] = []
        smoother: Solved | None = None
        if route.detours:
            found = climb(rungs, SMOOTH * settings.effort_weight)
            if found is None:
                return "; ".join(causes)
            smoother, _, rung = found
            duration = smoother.trajectory.times[-1]
            if duration + (smoother.objective - duration) / SMOOTH > rival * (1 + HOPELESS):
                return "another route is better"
            used, rungs = [rung], RUNGS
        found = climb(rungs, settings.effort_weight, smoother)
        if found is None:
            return "; ".join(causes)
        solved, residuals, rung = found
        used.append(rung)
        if route.detours and profile is not None and solved.trajectory.times[-1] <= profile.duration * (1 + NEARLY):
            # The profile told nothing about these boundaries; now that they are known, its switches can be nodes.
            boundaries = solved.trajectory.times[np.cumsum([0, *split_nodes(settings.nodes, phases)])]
            found = climb(RUNGS, settings.effort_weight, solved, boundaries)
            if found is not None and found[0].objective < solved.objective:
                solved, residuals, _ = found
        branch = branch_name(world, solved.trajectory.states[:, :POSE_SIZE])
        method = max(used, key=RUNGS.index).name
        return Candidate(branch, route.detours, solved.trajectory, solved.objective, residuals, method)

    def _program(self, phases: tuple[Any, ...], initial_velocity: str, solver: str, exact: bool) -> Any:
        # CasADi is loaded by the first solve: settings, verification and free space are read without it.
        from agile_jax.expert.programs.transcription import build_program

        key = (phases, initial_velocity, solver, exact)
        program = self._programs.pop(key, None)
        if program is None:
            half_size = self._torso_half_size if exact else None
            program = build_program(phases, initial_velocity, self._settings, solver, half_size)
        self._programs[key] = program  # last: the least recently used is first
        if len(self._programs) > MOST_PROGRAMS:
            del self._programs[next(iter(self._programs))]
        return program

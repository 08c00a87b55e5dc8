"""A nonlinear program with its solver, what goes in and what comes out. Loads no CasADi."""

from collections.abc import Mapping
from typing import Literal, NamedTuple, Protocol, SupportsFloat

import numpy as np

from agile_jax.expert.programs.layout import Layout, Variables
from agile_jax.expert.solution import Trajectory

RowKind = Literal["step", "end", "crossing", "rate", "pose", "face", "speed", "line", "touch", "edge"]


class Row(NamedTuple):
    """Some constraints of one kind."""

    kind: RowKind
    node: int
    phase: int
    size: int
    face: int = 0  # of those of the phase


class NlpSolver(Protocol):
    """A solver of CasADi."""

    def __call__(self, **inputs: np.ndarray) -> Mapping[str, SupportsFloat]:
        """Solution and objective ("x", "f") from guess, bounds and parameters."""

    def stats(self) -> Mapping[str, object]:
        """What there is to tell of the last call."""


class Program(NamedTuple):
    """A solver for all routes of one pattern of phases."""

    solver: NlpSolver
    layout: Layout
    rows: tuple[Row, ...]  # in the order of the program


class Inputs(NamedTuple):
    """Numbers of one route for its program of n variables and m constraints."""

    guess: np.ndarray  # (n,)
    lower: np.ndarray  # (n,) bounds of the variables
    upper: np.ndarray  # (n,)
    lower_rows: np.ndarray  # (m,) bounds of the constraints
    upper_rows: np.ndarray  # (m,)
    parameters: np.ndarray
    fractions: np.ndarray  # (T,) lengths of the intervals, relative to their phase


class Solved(NamedTuple):
    """What the solver returns."""

    trajectory: Trajectory
    objective: float
    success: bool  # what the solver claims
    status: str
    variables: np.ndarray  # (n,)


def solve_program(program: Program, inputs: Inputs) -> Solved:
    """Run the solver."""
    result = program.solver(
        x0=inputs.guess,
        lbx=inputs.lower,
        ubx=inputs.upper,
        lbg=inputs.lower_rows,
        ubg=inputs.upper_rows,
        p=inputs.parameters,
    )
    stats = program.solver.stats()
    vector = np.array(result["x"]).ravel()
    variables = program.layout.unpack(vector)
    trajectory = _trajectory(variables, inputs.fractions, program.layout.linear)
    return Solved(trajectory, float(result["f"]), bool(stats["success"]), str(stats["return_status"]), vector)


def _trajectory(variables: Variables, fractions: np.ndarray, linear: bool) -> Trajectory:
    times = np.concatenate([[0.0], np.cumsum(variables.durations[:-1] * fractions)])
    controls = variables.accelerations if linear else variables.controls
    return Trajectory(times, np.concatenate([variables.poses, variables.rates], axis=1), controls)

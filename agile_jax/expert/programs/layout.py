"""Which variable and which parameter of the general program is what: the one place that knows their order.

The variables are x_0, u_0, x_1, ..., x_T, as FATROP's stage structure needs them. A state x_k holds the pose, the rate
and the duration of its phase; for accelerations that are linear over an interval, also the acceleration at the node.
A control u_k holds the accelerations, the angle of the plane around an edge where its phase has one, and, at the end
of a phase, the duration of the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from agile_jax.scene import POSE_SIZE

EDGE_INTERVALS = 3  # of a phase around an edge; it is short, and its path hardly curved
Values = TypeVar("Values")  # numbers, or symbols of CasADi


class Phase(NamedTuple):
    """What a program knows of a phase."""

    edge: bool  # whether it is around an edge
    faces: int  # that the corners must keep beyond
    slow: tuple[int, ...] = ()  # the axes whose top speed can be below their bound of the velocity at its heights


class Variables(NamedTuple):
    """Variables of T intervals in P phases, E of the intervals around edges; or their places in the vector."""

    poses: np.ndarray  # (T+1, 4) [m, rad]
    rates: np.ndarray  # (T+1, 4) [m/s, rad/s]
    durations: np.ndarray  # (T+1,) of the phase that a node is in [s]
    accelerations: np.ndarray  # (T+1, 4) at the nodes, where they are linear in between; else (0, 4) [m/s^2, rad/s^2]
    controls: np.ndarray  # (T, 4) accelerations over an interval, or, where they are linear, at its end
    angles: np.ndarray  # (E,) of planes around edges [rad]
    next_durations: np.ndarray  # (P-1,) chosen at the end of a phase [s]


class Parameters(NamedTuple, Generic[Values]):
    """Parameters of P phases with M faces in all, around E edges."""

    start: Values  # (4,) pose
    target: Values  # (4,)
    crossings: Sequence[Values]  # P-1 of (7,): normal, its direction in the plane, footprint's weight, offset
    faces: Sequence[Values]  # M of (4,): normal, offset
    edges: Sequence[Values]  # E of (9,): two faces, the margin
    lines: Values  # (2 S,) intercept and slope of a bound of the speed, for each of S intervals of slow phases
    fractions: Values  # (T,) lengths of the intervals, relative to their phase
    weight: Values  # (1,) of the effort

    def in_order(self) -> list[Values]:
        """All of them, as they stand in the vector."""
        several = (*self.crossings, *self.faces, *self.edges)
        return [self.start, self.target, *several, self.lines, self.fractions, self.weight]


@dataclass(frozen=True)
class Layout:
    """The order of the variables.

    Attributes:
        phases: P of them.
        nodes: T, the number of intervals in all.
        linear: whether accelerations are linear over an interval; else they are constant.
    """

    phases: tuple[Phase, ...]
    nodes: int
    linear: bool

    @cached_property
    def intervals(self) -> tuple[int, ...]:
        """How many each phase has."""
        return split_nodes(self.nodes, self.phases)

    @cached_property
    def first_nodes(self) -> list[int]:
        """The node at which each phase begins."""
        return np.cumsum([0, *self.intervals])[:-1].tolist()

    @cached_property
    def phase_of(self) -> list[int]:
        """The phase of each interval."""
        return np.repeat(np.arange(len(self.phases)), self.intervals).tolist()

    @cached_property
    def slow_intervals(self) -> list[int]:
        """The intervals of phases in which the top speed matters."""
        return [k for k, phase in enumerate(self.phase_of) if self.phases[phase].slow]

    @cached_property
    def places(self) -> Variables:
        """Where each variable stands in the vector."""
        found: dict[str, list[object]] = {name: [] for name in Variables._fields}
        count = 0

        def place(name: str, size: int | None = None) -> None:
            nonlocal count
            found[name].append(count if size is None else range(count, count + size))
            count += 1 if size is None else size

        for k in range(self.nodes + 1):
            place("poses", POSE_SIZE)
            place("rates", POSE_SIZE)
            place("durations")
            if self.linear:
                place("accelerations", POSE_SIZE)
            if k == self.nodes:
                break
            place("controls", POSE_SIZE)
            if self.phases[self.phase_of[k]].edge:
                place("angles")
            if k + 1 in self.first_nodes:
                place("next_durations")
        arrays = {name: np.array(places, int) for name, places in found.items()}
        return Variables(**arrays | {"accelerations": arrays["accelerations"].reshape(-1, POSE_SIZE)})

    @cached_property
    def size(self) -> int:
        """The length of the vector."""
        return sum(places.size for places in self.places)

    def pack(self, variables: Variables) -> np.ndarray:
        """The vector of variables, shape (size,)."""
        vector = np.empty(self.size)
        for places, values in zip(self.places, variables, strict=True):
            vector[places] = values
        return vector

    def unpack(self, vector: np.ndarray) -> Variables:
        """The variables in a vector, shape (size,)."""
        return Variables(*(vector[places] for places in self.places))


def split_nodes(nodes: int, phases: Sequence[Phase]) -> tuple[int, ...]:
    """Intervals of each phase: few around an edge, the others as even as possible, earlier phases first."""
    others = [p for p, phase in enumerate(phases) if not phase.edge]
    left = nodes - EDGE_INTERVALS * (len(phases) - len(others))
    more = others[: left % len(others)]
    return tuple(EDGE_INTERVALS if q.edge else left // len(others) + (p in more) for p, q in enumerate(phases))

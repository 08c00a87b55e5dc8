"""The minimum-time problem along a route as a nonlinear program in CasADi.

    minimise    T + w * integral of sum_i (u_i / a_i)^2 dt
    subject to  s'' = u,  s(0) = start,  s'(0) = 0 or free,  s(T) = target,  s'(T) = 0,
                |s'_i| <= v_i,  |u_i| <= a_i,  s(t) in region p during phase p,  crossings at their faces.

Direct collocation by one of the schemes of schemes.py. Each of the P phases has its own duration tau, carried as a
state so that the problem keeps its stage structure (layout.py says what a state and a control hold). Regions are simple
bounds; where the footprint turns with the yaw, or an obstacle is not parallel to the axes, the corners of
the torso must stay beyond a face of every obstacle, which adds rows:

    n . (p + R(yaw) corner) >= offset          for the four corners, per obstacle and phase

The top speed V(z) of a crouching robot (scene/crouch.py) is convex in z, so that |s'_i| <= V(z) is no convex set. In
the phases where it can matter each interval has one of the lines below V instead,

    |s'_i| <= a + b z                          for the horizontal axes, on all Bernstein coefficients,

and the program is solved again with the lines that touch V at the heights that were found (retries.py). A line is safe
by itself, and each solution remains one of the next program.

In a phase around an edge (edges.py) n is between two normals, at an angle that is a control, and the rows are on all
Bernstein coefficients of the interval. The structure depends on which phases are around edges, on how many faces
have rows in each, and on the settings; one program serves all routes that agree in it.
Rates are bounded at the nodes, which is enough where they are linear; a rate that is quadratic over an interval also
keeps its middle Bernstein coefficient, s' + h u / 2, within the bound, hence the whole of it. Poses are bounded by the
inner Bernstein coefficients of each interval and, where phases meet, by the nodes: all other nodes lie
between two such coefficients, so that regions hold between nodes, too. (Rows of a turning torso are not linear in its
pose; there it holds up to r yaw'^2 h^2 / 8, and the verifier decides.)

FATROP drops rows whose bounds are both infinite, but keeps their last multipliers: which rows there are must depend on
the program alone, or labels would depend on what was solved before.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from agile_jax.expert.programs.layout import Layout, Parameters, Phase
from agile_jax.expert.programs.program import Program, Row, RowKind
from agile_jax.expert.programs.schemes import LINEAR, control_points, rate_points, square_integral, step
from agile_jax.expert.settings import ExpertSettings
from agile_jax.scene import POSE_SIZE

CROSSING = 7  # parameters of a crossing: normal (3), direction in the plane (2), footprint's weight, offset
ROW = 4  # parameters of an obstacle's face: normal (3), offset
EDGE = 2 * ROW + 1  # parameters of an edge: its two faces, the margin
ROUNDING = 3e-3  # of the footprint's kinks at a crossing; the torso is then up to 1 mm beyond the face

# Iterations are limited, not seconds: a label must not depend on the machine's load.
FATROP = {"print_level": 0, "tol": 1e-8, "constr_viol_tol": 1e-9, "mu_init": 1e-2, "max_iter": 100}
# For what the first cannot solve: from farther inside the bounds, with more iterations.
FATROP_CAREFUL = FATROP | {"mu_init": 1.0, "bound_push": 1e-1, "bound_frac": 1e-1, "max_iter": 300}
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-9,
    "constr_viol_tol": 1e-10,
    "max_iter": 500,
    "linear_solver": "mumps",
    "option_file_name": "",  # else a file ipopt.opt in the working folder would silently change labels
}
SOLVERS: dict[str, tuple[str, Mapping[str, object]]] = {
    "fatrop": ("fatrop", FATROP),
    "fatrop-careful": ("fatrop", FATROP_CAREFUL),
    "ipopt": ("ipopt", IPOPT),
}
EQUALITIES = ("step", "end", "crossing")


class _Builder:
    """The symbols of a program, and the constraints and the objective as they are collected."""

    def __init__(self, layout: Layout, from_rest: bool, settings: ExpertSettings, half_size: np.ndarray | None) -> None:
        self._layout, self._from_rest, self._settings = layout, from_rest, settings
        self._half = np.ones(2) if half_size is None else half_size[:2]
        # Where the faces hold the footprint the torso is a point.
        signs = [(0, 0)] if half_size is None else [(i, j) for i in (1, -1) for j in (1, -1)]
        self._corners = [(i * self._half[0], j * self._half[1]) for i, j in signs]
        phases = layout.phases
        self._faces = [[ca.SX.sym(f"face{p}_{i}", ROW) for i in range(phase.faces)] for p, phase in enumerate(phases)]
        self._edges = {p: ca.SX.sym(f"edge{p}", EDGE) for p, phase in enumerate(phases) if phase.edge}
        self.parameters: Parameters[ca.SX] = Parameters(
            ca.SX.sym("start", POSE_SIZE),
            ca.SX.sym("target", POSE_SIZE),
            [ca.SX.sym(f"crossing{p}", CROSSING) for p in range(len(phases) - 1)],
            [face for faces in self._faces for face in faces],
            list(self._edges.values()),
            ca.SX.sym("lines", 2 * len(layout.slow_intervals)),
            ca.SX.sym("fractions", layout.nodes),
            ca.SX.sym("weight"),
        )
        self.variables = ca.SX.sym("x", layout.size)
        places = layout.places
        self._poses, self._rates, self._accelerations, self._controls = (
            [self.variables[nodes.tolist()] for nodes in one]
            for one in (places.poses, places.rates, places.accelerations, places.controls)
        )
        self._durations = [self.variables[place] for place in places.durations.tolist()]
        self._angles = iter([self.variables[place] for place in places.angles.tolist()])
        self._next_durations = [self.variables[place] for place in places.next_durations.tolist()]
        self.objective = ca.SX(0)
        self.expressions: list[ca.SX] = []
        self.rows: list[Row] = []

    def _require(self, kind: RowKind, node: int, phase: int, expression: ca.SX, face: int = 0) -> None:
        self.expressions.append(expression)
        self.rows.append(Row(kind, node, phase, expression.numel(), face))

    def _require_faces(self, kind: RowKind, node: int, phase: int, pose: ca.SX) -> None:
        for i, face in enumerate(self._faces[phase]):
            self._require(kind, node, phase, _corner_heights(pose, face, self._corners), i)

    def _require_lines(self, k: int, phase: int, points: Sequence[tuple[ca.SX, ca.SX]]) -> None:
        """Rates below a line in the height at all Bernstein coefficients, hence all the time."""
        place = 2 * self._layout.slow_intervals.index(k)
        intercept, slope = self.parameters.lines[place], self.parameters.lines[place + 1]
        for pose, rate in points:
            for axis in self._layout.phases[phase].slow:
                for sign in (1, -1):
                    self._require("line", k, phase, intercept + slope * pose[2] - sign * rate[axis])

    def add_interval(self, k: int) -> None:
        """The constraints and the cost of the interval after node k."""
        settings, layout, p = self._settings, self._layout, self._layout.phase_of[k]
        scheme, linear = settings.transcription, layout.linear
        pose, rate, tau, u_next = self._poses[k], self._rates[k], self._durations[k], self._controls[k]
        u, h = self._accelerations[k] if linear else u_next, tau * self.parameters.fractions[k]
        begins_phase, ends_phase = k > 0 and k in layout.first_nodes, k + 1 in layout.first_nodes
        # FATROP finds the stages by these rows: the step first, then what holds at the node.
        state = [self._poses[k + 1], self._rates[k + 1], self._durations[k + 1]]
        following = [*step(scheme, pose, rate, h, u, u_next), self._next_durations[p] if ends_phase else tau]
        if linear:
            state, following = [*state, self._accelerations[k + 1]], [*following, u_next]
        self._require("step", k, p, ca.vertcat(*state) - ca.vertcat(*following))
        if k == 0:
            self._require("end", k, p, pose - self.parameters.start)
            if self._from_rest:
                self._require("end", k, p, rate)
        elif begins_phase:
            self._require("crossing", k, p, _crossing(pose, self.parameters.crossings[p - 1], self._half))
        if settings.zero_end_controls and (k == 0 or (k == layout.nodes - 1 and not linear)):
            self._require("end", k, p, u)
        if linear:
            self._require("rate", k, p, rate + h / 2 * u)
        points = control_points(scheme, pose, rate, h, u, u_next)
        for point in points[:-1]:
            self._require("pose", k, p, point)
            self._require_faces("face", k, p, point)
        if settings.velocity_bound == "planar_norm":
            self._require("speed", k, 0, ca.sumsqr(rate[:2] / settings.limits.velocity[:2]))
        if layout.phases[p].slow:
            self._require_lines(
                k, p, [(pose, rate), *zip(points, rate_points(scheme, rate, h, u, u_next), strict=True)]
            )
        if begins_phase:
            self._require_faces("touch", k, p, pose)
            self._require_faces("touch", k, p - 1, pose)
        if p in self._edges:
            angle = next(self._angles)
            for point in (pose, *points):
                self._require("edge", k, p, _edge_heights(point, self._edges[p], angle, self._corners))
        scale = settings.limits.acceleration
        effort = ca.sum1(square_integral(scheme, h, u / scale, u_next / scale))
        self.objective += h + self.parameters.weight * effort

    def add_end(self) -> None:
        """The constraints at the last node."""
        last, p = self._layout.nodes, len(self._layout.phases) - 1
        self._require("end", last, p, self._poses[last] - self.parameters.target)
        self._require("end", last, p, self._rates[last])
        if self._settings.zero_end_controls and self._layout.linear:
            self._require("end", last, p, self._accelerations[last])


def build_program(
    phases: Sequence[Phase],
    from_rest: bool,
    settings: ExpertSettings,
    solver: str = "fatrop",
    half_size: np.ndarray | None = None,
) -> Program:
    """Build the program for routes with one pattern of phases.

    Args:
        phases: P of them.
        from_rest: whether the motion begins at rest, else with the best velocity.
        settings: nodes, scheme, weights.
        solver: a key of `SOLVERS`.
        half_size: of the torso, shape (3,) [m], where its yaw is to be heeded; None where the faces hold the footprint.
    """
    layout = Layout(tuple(phases), settings.nodes, settings.transcription in LINEAR)
    builder = _Builder(layout, from_rest, settings, half_size)
    for k in range(layout.nodes):
        builder.add_interval(k)
    builder.add_end()
    problem = {
        "x": builder.variables,
        "f": builder.objective,
        "g": ca.vertcat(*builder.expressions),
        "p": ca.vertcat(*builder.parameters.in_order()),
    }
    plugin, own = SOLVERS[solver]
    options: dict[str, Any] = {"expand": True, "print_time": False, "error_on_fail": False, plugin: own}
    if plugin == "fatrop":
        equality = [row.kind in EQUALITIES for row in builder.rows for _ in range(row.size)]
        options |= {"structure_detection": "auto", "equality": equality}
    name = "route_" + "_".join(f"{phase.edge:d}{phase.faces}" for phase in phases)
    return Program(ca.nlpsol(name, plugin, problem, options), layout, tuple(builder.rows))


def _corner_heights(pose: ca.SX, face: ca.SX, corners: Sequence[tuple[float, float]]) -> ca.SX:
    """How far the torso's corners lie beyond a face, shape (4,) for four of them."""
    x, y, z, yaw = (pose[i] for i in range(POSE_SIZE))
    along = face[0] * ca.cos(yaw) + face[1] * ca.sin(yaw)
    across = face[1] * ca.cos(yaw) - face[0] * ca.sin(yaw)
    middle = face[0] * x + face[1] * y + face[2] * z - face[3]
    return ca.vertcat(*(middle + a * along + b * across for a, b in corners))


def _edge_heights(pose: ca.SX, edge: ca.SX, angle: ca.SX, corners: Sequence[tuple[float, float]]) -> ca.SX:
    """How much farther than the margin the torso's corners lie beyond a plane through an edge."""
    first = _corner_heights(pose, edge[:ROW], corners)
    second = _corner_heights(pose, edge[ROW : 2 * ROW], corners)
    return ca.cos(angle) * first + ca.sin(angle) * second - edge[2 * ROW]


def _crossing(pose: ca.SX, crossing: ca.SX, half: np.ndarray) -> ca.SX:
    """Zero where the torso, or its centre when the footprint's weight is zero, touches the crossed plane."""
    yaw = pose[3]
    along = crossing[3] * ca.cos(yaw) + crossing[4] * ca.sin(yaw)
    across = crossing[4] * ca.cos(yaw) - crossing[3] * ca.sin(yaw)
    footprint = half[0] * ca.sqrt(along**2 + ROUNDING**2) + half[1] * ca.sqrt(across**2 + ROUNDING**2)
    return ca.dot(crossing[:3], pose[:3]) - crossing[5] * footprint - crossing[6]

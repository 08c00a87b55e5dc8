"""The expert as a planner in the loop, to compare the policy with: open loop, or planning again and again."""

import time

import numpy as np
from jaxtyping import Bool, Float, Int

from agile_jax.expert import ExpertSettings, InitialVelocity, make_expert, planning_margin
from agile_jax.scene import POSE_SIZE, Scene, clearance
from agile_jax.simulation import TimedPath

INSET = 1e-6  # [m, rad] a measured pose is moved into the bounds by this


class ExpertPlanner:
    """Paths of the CasADi expert, one for each slot.

    The first is planned from rest; the next ones, every `interval`, from the measured pose with the best initial
    velocity, as the policy's labels are. Where the expert finds no path (the robot may be nearer to an obstacle than
    the margin), the last one is followed on; without any, the robot stays where it is.

    A path that is planned once waits for a robot that has fallen behind: its heights belong to its places, and by the
    clock alone a robot that is late would stand up under a table.
    """

    def __init__(self, scene: Scene, settings: ExpertSettings, slots: int, interval: float | None, lead: float) -> None:
        """Plan nothing yet.

        Args:
            scene, settings: of the expert.
            slots: n.
            interval: between two plans [s]; None plans once.
            lead: how far a reference may be ahead of the robot in the plane; a path waits at twice that [m].
        """
        self._scene, self._settings, self._interval = scene, settings, interval
        self._expert, self._lead = make_expert(scene, settings), lead
        self._now = np.zeros(slots)  # the episodes' clocks at the last plan [s]
        nodes = settings.nodes + 1
        self._paths = TimedPath(
            np.tile(np.arange(nodes, dtype=float), (slots, 1)),
            np.zeros((slots, nodes, POSE_SIZE)),
            np.zeros((slots, nodes, POSE_SIZE)),
            np.zeros(slots),
        )
        self.solve_times: list[float] = []  # of every query [s]

    @property
    def paths(self) -> TimedPath:
        """The present path in each slot."""
        return TimedPath(*(np.asarray(values, np.float32) for values in self._paths))

    def begin(self, slots: Int[np.ndarray, " k"], poses: Float[np.ndarray, "k 4"]) -> None:
        """Plan for new episodes from rest."""
        for slot, pose in zip(slots, poses, strict=True):
            self._paths.times[slot] = np.arange(self._paths.times.shape[1])
            self._now[slot] = 0.0
            self._paths.poses[slot], self._paths.rates[slot], self._paths.begun[slot] = pose, 0.0, 0.0
            self._plan(int(slot), pose, 0.0, "rest")

    def advance(
        self, poses: Float[np.ndarray, "n 4"], times: Float[np.ndarray, " n"], active: Bool[np.ndarray, " n"]
    ) -> None:
        """Plan again for those whose path is old enough."""
        if self._interval is None:
            self._wait(poses, times, active & np.isfinite(poses).all(-1))
            return
        due = active & (times - self._paths.begun >= self._interval - 1e-6) & np.isfinite(poses).all(-1)
        for slot in np.flatnonzero(due):
            self._plan(int(slot), poses[slot], float(times[slot]), "free")

    def _wait(
        self, poses: Float[np.ndarray, "n 4"], times: Float[np.ndarray, " n"], active: Bool[np.ndarray, " n"]
    ) -> None:
        """Stop the clocks of paths that are too far ahead, along their own direction."""
        elapsed, self._now = times - self._now, times.copy()
        for slot in np.flatnonzero(active):
            since = times[slot] - self._paths.begun[slot]
            place, rate = (
                np.array([np.interp(since, self._paths.times[slot], values[slot, :, i]) for i in range(2)])
                for values in (self._paths.poses, self._paths.rates)
            )
            if (place - poses[slot, :2]) @ rate > 2 * self._lead * np.hypot(*rate):
                self._paths.begun[slot] += elapsed[slot]

    def _plan(self, slot: int, pose: Float[np.ndarray, "4"], now: float, initial_velocity: InitialVelocity) -> None:
        pose = np.clip(pose, self._scene.lower + INSET, self._scene.upper - INSET)
        begun = time.perf_counter()
        if clearance(self._scene, pose) >= planning_margin(self._settings):
            solution = self._expert.solve(pose, initial_velocity=initial_velocity)
            if solution.status == "solved":
                trajectory = solution.trajectory
                self._paths.times[slot] = trajectory.times
                self._paths.poses[slot] = trajectory.states[:, :POSE_SIZE]
                self._paths.rates[slot] = trajectory.states[:, POSE_SIZE:]
                self._paths.begun[slot] = now
        self.solve_times.append(time.perf_counter() - begun)

"""The figures and the video of a run, as HTML: each reads what it needs from the run directory.

What is not there yet is left out with a sentence.
"""

import io
import pathlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from PIL import Image

from agile_jax.expert import ExpertSettings, Trajectory, make_expert, planning_margin
from agile_jax.files import write_atomic
from agile_jax.report import page
from agile_jax.report.figures.episode_figures import draw_episode, draw_outcomes
from agile_jax.report.figures.evaluation_figures import draw_qualities, draw_success_map, read_qualities
from agile_jax.report.figures.kinematic_test_figures import (
    draw_arrivals,
    draw_error_map,
    draw_worst_paths,
    read_closed_loop,
)
from agile_jax.report.figures.learning_figures import (
    draw_learning_curve,
    draw_velocity_field,
    draw_velocity_field_side,
    read_metrics,
)
from agile_jax.report.figures.plan_figures import draw_plan
from agile_jax.report.settings import ReportSettings
from agile_jax.report.traces import Episode, choose_episode, load_episodes, load_outcomes, went_under
from agile_jax.report.video.camera import film, join, snapshots
from agile_jax.report.video.video import SIM_DT, Rendered, render_shot, write_mp4
from agile_jax.robot import RobotSettings, build_mujoco_model, load_robot
from agile_jax.scene import Scene, SceneSettings, clearance, make_scene, planar_scene

if TYPE_CHECKING:
    from agile_jax.policy import PolicySettings


class Inputs(Protocol):
    """The settings that a report reads; an Experiment has them."""

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def scene(self) -> SceneSettings: ...  # noqa: D102

    @property
    def expert(self) -> ExpertSettings: ...  # noqa: D102

    @property
    def policy(self) -> "PolicySettings": ...  # noqa: D102

    @property
    def robot(self) -> RobotSettings: ...  # noqa: D102

    @property
    def report(self) -> ReportSettings: ...  # noqa: D102


def paths(run_dir: pathlib.Path, inputs: Inputs) -> str:
    """The paper's figure 2: the plan in space and the plan in the plane, from one start at the target's height."""
    scene = make_scene(inputs.scene)
    start = np.array([*inputs.report.paths_start, scene.target[2], scene.target[3]])
    planners: dict[str, tuple[Literal["3d", "2d"], Scene]] = {"3D: may change its height": ("3d", scene)}
    if len(scene.obstacle_centers):
        planners["2D: keeps its height,\nobstacles are full boxes"] = ("2d", planar_scene(scene))
    drawn: dict[str, Trajectory] = {}
    sentences = []
    for label, (planner, world) in planners.items():
        short = label.split(":")[0]
        blocked = [
            name for name, pose in (("start", start), ("target", world.target))
            if clearance(world, pose) < planning_margin(inputs.expert)
        ]  # fmt: skip
        if blocked:
            sentences.append(f"There is no {short} path: its {blocked[0]} is too near to an obstacle.")
            continue
        expert = make_expert(scene, inputs.expert.model_copy(update={"dimensions": planner}))
        solution = expert.solve(start, initial_velocity="rest")  # the paper's, however the labels begin
        if solution.status == "solved":
            drawn[f"{label}\n({solution.branch})"] = solution.trajectory
            sentences.append(
                f"{short}: {solution.duration:.2f} s, {solution.branch}, at least {solution.lower_bound:.2f} s."
            )
        else:
            sentences.append(f"The expert found no {short} path: {solution.cause}.")
    words = page.paragraph(" ".join(sentences))
    if not drawn:
        return words
    path = draw_plan(scene, drawn, run_dir / "figures" / "paths.png")
    caption = (
        f"Minimum-time paths from ({start[0]:g}, {start[1]:g}) m to the target, from above, from the side and from the "
        "front. Rectangles: the torso's envelope at equal intervals of time."
    )
    return page.picture(path, caption) + words


def learning_curve(run_dir: pathlib.Path, noise_floor: float | None) -> str:
    """Error by epoch."""
    directory = run_dir / "training"
    rounds = sorted(directory.glob("round-*/metrics.jsonl"), key=lambda path: int(path.parent.name.partition("-")[2]))
    rows: list[dict[str, Any]] = []
    for metrics in [*rounds, directory / "metrics.jsonl"]:
        found = read_metrics(metrics) if metrics.is_file() else []
        rows += [row | {"epoch": row.get("epoch", 0) + len(rows)} for row in found]
    if not rows:
        return page.paragraph("There is no learning curve: training/metrics.jsonl holds no epoch yet.")
    path = draw_learning_curve(rows, noise_floor, run_dir / "figures" / "learning_curve.png")
    return page.picture(
        path,
        "Error of the field on the training and on the validation trajectories; dotted: the labels' own noise.",
    )


def velocity_field(run_dir: pathlib.Path, inputs: Inputs) -> str:
    """Streamlines of the learned field at the target's height and, under an obstacle, at the height of crawling."""
    directory = run_dir / "training"
    if not (directory / "checkpoints").is_dir():
        return ""
    from agile_jax.policy import make_policy, make_velocities  # they load JAX
    from agile_jax.training import load_parameters

    scene = make_scene(inputs.scene)
    policy = make_policy(scene, np.array(inputs.expert.velocity), np.array(inputs.expert.acceleration), inputs.policy)
    velocities = make_velocities(policy, load_parameters(directory, policy))
    heights = {f"at the target's height, {scene.target[2]:.2f} m": float(scene.target[2])}
    crawl = crawl_height(scene, planning_margin(inputs.expert))
    if crawl is not None:
        heights[f"at the height of crawling, {crawl:.2f} m"] = crawl
    path = run_dir / "figures" / "velocity_field.png"
    draw_velocity_field(scene, velocities, heights, path)
    what = "acceleration from rest" if policy.learns == "acceleration" else "velocity field"
    above = page.picture(
        path,
        f"The learned {what} from above, at the target's yaw. Nothing is drawn where the torso would touch the "
        "obstacle.",
    )
    path = draw_velocity_field_side(scene, velocities, run_dir / "figures" / "velocity_field_side.png")
    return above + page.picture(
        path, "The same from the side, in the plane of the target: how it ducks, and rises again."
    )


def closed_loop(run_dir: pathlib.Path, inputs: Inputs) -> str:
    """Where the field errs, and how its closed loop ends from held-out starts."""
    scene, figures, directory = make_scene(inputs.scene), run_dir / "figures", run_dir / "training"
    html = ""
    if (directory / "test_errors.npz").is_file():
        with np.load(directory / "test_errors.npz", allow_pickle=False) as file:
            path = draw_error_map(scene, file["pose"], file["error"], figures / "error_map.png")
        html += page.picture(path, "Error on held-out trajectories by place, from above and from the side.")
    if (directory / "closed_loop.npz").is_file():
        loops = read_closed_loop(directory / "closed_loop.npz")
        path = draw_arrivals(scene, loops, figures / "arrivals.png")
        html += page.picture(
            path,
            f"A kinematic robot follows the policy from {len(loops.start)} starts that no training has seen: arrival "
            "time over the expert's from the same start, and how many failed.",
        )
        path = draw_worst_paths(scene, loops, figures / "worst_paths.png")
        html += page.picture(
            path, "The worst of them: those that failed, came nearest to an obstacle, or arrived latest."
        )
    return html


def crawl_height(scene: Scene, margin: float) -> float | None:
    """Greatest height [m] of the torso's centre under the lowest obstacle that can be passed under, or None."""
    undersides = scene.obstacle_centers[:, 2] - scene.obstacle_half_sizes[:, 2]
    heights = undersides - scene.torso_half_size[2] - margin
    passable = heights[heights > scene.lower[2]]
    return float(passable.min()) if len(passable) else None


def evaluation(run_dir: pathlib.Path, inputs: Inputs, backend: str) -> tuple[str, str, Rendered | None]:
    """Figures of an evaluation.

    Returns:
        HTML of the outcomes and the episode; HTML of video and snapshots, "" without traces; how these were rendered.
    """
    scene = make_scene(inputs.scene)
    figures, folder = run_dir / "figures", run_dir / "evaluation"
    rows = folder / f"{backend}.npz"
    if not rows.is_file():
        return page.paragraph(f"There is no evaluation/{backend}.npz."), "", None
    outcomes = load_outcomes(rows)
    shown = page.picture(
        draw_outcomes(scene, outcomes, figures / f"outcomes_{backend}.png"),
        "Where the episodes started, and how they ended. Obstacles are brown, the target is the arrow.",
    )
    robot = load_robot(inputs.robot)
    map_of_success = draw_success_map(scene, outcomes, figures / f"success_{backend}.png")
    if map_of_success is not None:
        shown += page.picture(
            map_of_success, "Starts by cell, with their number; where episodes failed, red, with how many of them did."
        )
    qualities = draw_qualities(
        read_qualities(rows, float(robot.link_masses.sum())), figures / f"qualities_{backend}.png"
    )
    if qualities is not None:
        shown += page.picture(qualities, "How the episodes went, as cumulative distributions.")
    traces = folder / f"{backend}-traces.npz"
    episode = choose_episode(scene, load_episodes(traces, outcomes)) if traces.is_file() else None
    if episode is None:
        return shown + page.paragraph("No episode was recorded."), "", None
    limit = np.asarray(robot.torque_limit)
    path = draw_episode(scene, episode, limit, figures / f"episode_{backend}.png")
    shown += page.picture(
        path,
        f"Episode {episode.row} ({episode.outcome}): height of the trunk and what is above it, speed in the plane, "
        "clearance of the torso's envelope, torques of the twelve joints.",
    )
    return shown, *_pictures(run_dir, inputs, scene, episode, backend)


def _pictures(
    run_dir: pathlib.Path, inputs: Inputs, scene: Scene, episode: Episode, backend: str
) -> tuple[str, Rendered]:
    """Video and snapshots (the paper's figure 3) of an episode, rendered in one go."""
    settings = inputs.report
    video, still = run_dir / "videos" / f"{backend}.mp4", run_dir / "figures" / f"snapshots_{backend}.png"
    shot = snapshots(scene, episode.time, episode.qpos)
    count = len(shot.qpos)
    if settings.video:
        shot = join(shot, film(episode.time, episode.qpos, settings.frames_per_second, settings.longest_video))

    def consume(frames: Iterator[np.ndarray]) -> None:
        stills = [next(frames) for _ in range(count)]
        sheet = np.concatenate([np.concatenate(stills[:2], 1), np.concatenate(stills[2:], 1)])
        buffer = io.BytesIO()
        Image.fromarray(sheet).save(buffer, "PNG")
        write_atomic(still, buffer.getvalue())
        if settings.video:
            write_mp4(video, frames, settings.frames_per_second)

    rendered = render_shot(build_mujoco_model(scene, inputs.robot, SIM_DT), shot, settings, consume)
    under = "crawls under an obstacle" if went_under(scene, episode) else "moves to the target"
    html = ""
    if settings.video:
        html += page.film(
            video, f"The robot {under}: episode {episode.row} ({episode.outcome}), {backend}, in real time."
        )
    html += page.picture(still, f"Snapshots of the same episode ({backend}); times and trunk heights in the corners.")
    if rendered.note:
        html += page.paragraph(rendered.note, soft=True)
    return html, rendered

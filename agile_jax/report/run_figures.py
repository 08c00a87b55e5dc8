"""The figures and the video of a run, as HTML: each reads what it needs from the run directory.

What is not there yet is left out with a sentence.
"""

import io
import pathlib
from collections.abc import Iterator
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from agile_jax.experiment import Experiment
from agile_jax.expert import Trajectory, make_expert, planning_margin
from agile_jax.files import write_atomic
from agile_jax.report import page, reading
from agile_jax.report.figures import episode_figures, evaluation_figures, kinematic_test_figures, learning_figures
from agile_jax.report.figures.plan_figures import plan_figure
from agile_jax.report.figures.style import new_axes, save_figure
from agile_jax.report.json_files import Summary, read_metrics
from agile_jax.report.sections import error_unit, squared_error_unit
from agile_jax.report.under_obstacles import crawl_height, went_under
from agile_jax.report.video.camera import Picture, film, join, snapshots
from agile_jax.report.video.video import SIM_DT, Rendered, render_shot, write_mp4
from agile_jax.robot import build_mujoco_model, load_robot
from agile_jax.scene import Scene, clearance, make_scene, planar_scene
from agile_jax.training import load_policy

CAPTIONS = {  # by the name of the figure
    "paths": "Minimum-time paths from ({x:g}, {y:g}) m to the target, from above, from the side and from the front. "
    "Rectangles: the torso's envelope at equal intervals of time.",
    "learning_curve": "Error of the field on the training and on the validation trajectories; dotted: the labels' own "
    "noise.",
    "velocity_field": "The learned {what} from above, at the target's yaw. Nothing is drawn where the torso would "
    "touch the obstacle.",
    "velocity_field_side": "The same from the side, in the plane of the target: how it ducks, and rises again.",
    "error_map": "Error on held-out trajectories by place, from above and from the side.",
    "arrivals": "A kinematic robot follows the policy from {starts} starts that no training has seen: arrival time "
    "over the duration of the expert's path from the same start, and how many failed.",
    "worst_paths": "The worst of them: those that failed, came nearest to an obstacle, or arrived latest.",
    "outcomes": "Where the episodes started, and how they ended. Obstacles are brown, the target is the arrow.",
    "success": "Starts by cell, with their number; where episodes failed, red, with how many of them did.",
    "qualities": "How the episodes went, as cumulative distributions.",
    "episode": "Episode {row} ({outcome}): height of the trunk and what is above it, speed in the plane, clearance of "
    "the torso's envelope, torques of the twelve joints.",
}
FEW = 400  # episodes below which the single starts say more than a map


def paths(run_dir: pathlib.Path, experiment: Experiment) -> str:
    """The paper's figure 2: the plan in space and the plan in the plane, from one start at the target's height."""
    scene = make_scene(experiment.scene)
    start = np.array([*experiment.report.paths_start, scene.target[2], scene.target[3]])
    planners: dict[str, tuple[Literal["3d", "2d"], Scene]] = {"3D: may change its height": ("3d", scene)}
    if len(scene.obstacle_centers):
        planners["2D: keeps its height,\nobstacles are full boxes"] = ("2d", planar_scene(scene))
    drawn: dict[str, Trajectory] = {}
    sentences = []
    for label, (planner, world) in planners.items():
        short = label.split(":")[0]
        blocked = [
            name for name, pose in (("start", start), ("target", world.target))
            if clearance(world, pose) < planning_margin(experiment.expert)
        ]  # fmt: skip
        if blocked:
            sentences.append(f"There is no {short} path: its {blocked[0]} is too near to an obstacle.")
            continue
        expert = make_expert(scene, experiment.expert.model_copy(update={"dimensions": planner}))
        solution = expert.solve(start, initial_velocity="rest")  # the paper's, however the labels begin
        if solution.status == "solved":
            drawn[f"{label}\n({solution.branch})"] = solution.trajectory
            sentences.append(
                f"{short}: {solution.duration:.2f} s, route {solution.branch}; no path takes less than "
                f"{solution.lower_bound:.2f} s."
            )
        else:
            sentences.append(f"The expert found no {short} path: {solution.cause}.")
    words = page.paragraph(" ".join(sentences))
    if not drawn:
        return words
    return _picture(run_dir, "paths", plan_figure(scene, drawn), x=start[0], y=start[1]) + words


def learning_curve(run_dir: pathlib.Path, experiment: Experiment, noise_floor: float | None) -> str:
    """Error by epoch."""
    directory = run_dir / "training"
    rounds = sorted(directory.glob("round-*/metrics.jsonl"), key=lambda path: int(path.parent.name.partition("-")[2]))
    rows: list[Summary] = []
    for metrics in [*rounds, directory / "metrics.jsonl"]:
        for row in read_metrics(metrics) if metrics.is_file() else []:
            rows.append(row | {"epoch": len(rows)})
    if not rows:
        return page.paragraph("There is no learning curve: training/metrics.jsonl holds no epoch yet.")
    ax = new_axes(7.0, 3.6)
    learning_figures.draw_learning_curve(ax, rows, noise_floor, squared_error_unit(experiment.policy.kind))
    return _picture(run_dir, "learning_curve", ax)


def velocity_field(run_dir: pathlib.Path, experiment: Experiment) -> str:
    """Streamlines of the learned field at the target's height and, under an obstacle, at the height of crawling."""
    directory = run_dir / "training"
    if not (directory / "checkpoints").is_dir():
        return ""
    scene = make_scene(experiment.scene)
    policy = load_policy(directory, scene, experiment.expert.limits, experiment.policy)
    heights = {f"at the target's height, {scene.target[2]:.2f} m": float(scene.target[2])}
    crawl = crawl_height(scene, planning_margin(experiment.expert))
    if crawl is not None:
        heights[f"at the height of crawling, {crawl:.2f} m"] = crawl
    accelerations = policy.policy.learns == "acceleration"
    what = "acceleration from rest" if accelerations else "velocity field"
    amount = learning_figures.ACCELERATION if accelerations else learning_figures.SPEED
    figure = learning_figures.velocity_field_figure(scene, policy.batch, heights, amount)
    side = learning_figures.draw_velocity_field_side(new_axes(7.4, 2.9), scene, policy.batch, amount)
    return _picture(run_dir, "velocity_field", figure, what=what) + _picture(run_dir, "velocity_field_side", side)


def kinematic_test(run_dir: pathlib.Path, experiment: Experiment) -> str:
    """Where the field errs, and how a kinematic robot that follows it ends from held-out starts."""
    scene, directory, html = make_scene(experiment.scene), run_dir / "training", ""
    if (directory / "test_errors.npz").is_file():
        poses, errors = reading.load_test_errors(directory / "test_errors.npz")
        figure = kinematic_test_figures.error_map_figure(scene, poses, errors, error_unit(experiment.policy.kind))
        html += _picture(run_dir, "error_map", figure)
    if (directory / "kinematic_test.npz").is_file():
        test = reading.load_kinematic_test(directory / "kinematic_test.npz")
        figure = kinematic_test_figures.arrivals_figure(scene, test)
        html += _picture(run_dir, "arrivals", figure, starts=len(test.start))
        html += _picture(run_dir, "worst_paths", kinematic_test_figures.worst_paths_figure(scene, test))
    return html


def evaluation(run_dir: pathlib.Path, experiment: Experiment, backend: str) -> tuple[str, str, Rendered | None]:
    """Figures of an evaluation.

    Returns:
        HTML of the outcomes and the episode; HTML of video and snapshots, "" without traces; how these were rendered.
    """
    scene, robot = make_scene(experiment.scene), load_robot(experiment.robot)
    rows = run_dir / "evaluation" / f"{backend}.npz"
    if not rows.is_file():
        return page.paragraph(f"There is no evaluation/{backend}.npz."), "", None
    outcomes = reading.load_outcomes(rows)
    ax = evaluation_figures.draw_outcomes(new_axes(8.0, 4.6), scene, outcomes)
    shown = _picture(run_dir, "outcomes", ax, backend)
    if len(outcomes.outcome) >= FEW:
        ax = evaluation_figures.draw_success_map(new_axes(8.0, 5.4), scene, outcomes)
        shown += _picture(run_dir, "success", ax, backend)
    found = evaluation_figures.qualities(reading.load_columns(rows), float(robot.link_masses.sum()))
    if found:
        shown += _picture(run_dir, "qualities", evaluation_figures.qualities_figure(found), backend)
    traces = run_dir / "evaluation" / f"{backend}-traces.npz"
    episode = reading.choose_episode(scene, reading.load_episodes(traces, outcomes)) if traces.is_file() else None
    if episode is None:
        return shown + page.paragraph("No episode was recorded."), "", None
    figure = episode_figures.episode_figure(scene, episode.trace, np.asarray(robot.torque_limit))
    shown += _picture(run_dir, "episode", figure, backend, row=episode.row, outcome=episode.outcome)
    return shown, *_pictures(run_dir, experiment, scene, episode, backend)


def _picture(run_dir: pathlib.Path, name: str, drawn: Figure | Axes, backend: str = "", **values: object) -> str:
    """Keep a figure in `figures/` of the run, one for each backend where there are several, and show it."""
    file = f"{name}_{backend}.png" if backend else f"{name}.png"
    path = save_figure(drawn, run_dir / "figures" / file)
    return page.picture(path, CAPTIONS[name].format(**values))


def _pictures(
    run_dir: pathlib.Path, experiment: Experiment, scene: Scene, episode: reading.Episode, backend: str
) -> tuple[str, Rendered]:
    """Video and snapshots (the paper's figure 3) of an episode, rendered in one go."""
    settings, trace = experiment.report, episode.trace
    video, still = run_dir / "videos" / f"{backend}.mp4", run_dir / "figures" / f"snapshots_{backend}.png"
    shot = snapshots(scene, trace.time, trace.qpos)
    count = len(shot.qpos)
    if settings.video:
        shot = join(shot, film(trace.time, trace.qpos, settings.frames_per_second, settings.longest_video))

    def consume(frames: Iterator[Picture]) -> None:
        stills = [next(frames) for _ in range(count)]
        sheet = np.concatenate([np.concatenate(stills[:2], 1), np.concatenate(stills[2:], 1)])
        buffer = io.BytesIO()
        Image.fromarray(sheet).save(buffer, "PNG")
        write_atomic(still, buffer.getvalue())
        if settings.video:
            write_mp4(video, frames, settings.frames_per_second)

    rendered = render_shot(build_mujoco_model(scene, experiment.robot, SIM_DT), shot, settings, consume)
    under = "crawls under an obstacle" if went_under(scene, trace.qpos[:, :3]) else "moves to the target"
    html = ""
    if settings.video:
        html += page.film(
            video, f"The robot {under}: episode {episode.row} ({episode.outcome}), {backend}, in real time."
        )
    html += page.picture(still, f"Snapshots of the same episode ({backend}); times and trunk heights in the corners.")
    if rendered.note:
        html += page.paragraph(rendered.note, soft=True)
    return html, rendered

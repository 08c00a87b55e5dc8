"""The figures and the video of a run, as HTML: each reads what it needs from the run directory.

What is not there yet is left out with a sentence.
"""

import io
import pathlib
from collections.abc import Iterator
from typing import Literal

import numpy as np
from PIL import Image

from agile_jax.experiment import Experiment
from agile_jax.expert import Trajectory, make_expert, planning_margin
from agile_jax.files import write_atomic
from agile_jax.report import page
from agile_jax.report.figures.episode_figures import episode_figure
from agile_jax.report.figures.evaluation_figures import (
    draw_outcomes,
    draw_success_map,
    qualities,
    qualities_figure,
)
from agile_jax.report.figures.kinematic_test_figures import arrivals_figure, error_map_figure, worst_paths_figure
from agile_jax.report.figures.learning_figures import (
    ACCELERATION,
    SPEED,
    draw_learning_curve,
    draw_velocity_field_side,
    velocity_field_figure,
)
from agile_jax.report.figures.plan_figures import plan_figure
from agile_jax.report.figures.style import new_figure, save_figure
from agile_jax.report.json_files import Summary, read_metrics
from agile_jax.report.reading import (
    Episode,
    choose_episode,
    load_columns,
    load_episodes,
    load_kinematic_test,
    load_outcomes,
    load_test_errors,
)
from agile_jax.report.sections import error_unit, squared_error_unit
from agile_jax.report.under_obstacles import crawl_height, went_under
from agile_jax.report.video.camera import Picture, film, join, snapshots
from agile_jax.report.video.video import SIM_DT, Rendered, render_shot, write_mp4
from agile_jax.robot import build_mujoco_model, load_robot
from agile_jax.scene import Scene, clearance, make_scene, planar_scene
from agile_jax.training import load_policy

TEST_ROWS = ("kinematic_test.npz", "closed_loop.npz")  # the second of older runs
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
    path = save_figure(plan_figure(scene, drawn), run_dir / "figures" / "paths.png")
    caption = (
        f"Minimum-time paths from ({start[0]:g}, {start[1]:g}) m to the target, from above, from the side and from the "
        "front. Rectangles: the torso's envelope at equal intervals of time."
    )
    return page.picture(path, caption) + words


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
    figure = new_figure(7.0, 3.6)
    draw_learning_curve(figure.add_subplot(), rows, noise_floor, squared_error_unit(experiment.policy.kind))
    return page.picture(
        save_figure(figure, run_dir / "figures" / "learning_curve.png"),
        "Error of the field on the training and on the validation trajectories; dotted: the labels' own noise.",
    )


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
    amount = ACCELERATION if accelerations else SPEED
    figure = velocity_field_figure(scene, policy.batch, heights, amount)
    above = page.picture(
        save_figure(figure, run_dir / "figures" / "velocity_field.png"),
        f"The learned {what} from above, at the target's yaw. Nothing is drawn where the torso would touch the "
        "obstacle.",
    )
    figure = new_figure(7.4, 2.9)
    draw_velocity_field_side(figure.add_subplot(), scene, policy.batch, amount)
    return above + page.picture(
        save_figure(figure, run_dir / "figures" / "velocity_field_side.png"),
        "The same from the side, in the plane of the target: how it ducks, and rises again.",
    )


def kinematic_test(run_dir: pathlib.Path, experiment: Experiment) -> str:
    """Where the field errs, and how a kinematic robot that follows it ends from held-out starts."""
    scene, figures, directory = make_scene(experiment.scene), run_dir / "figures", run_dir / "training"
    html = ""
    if (directory / "test_errors.npz").is_file():
        figure = error_map_figure(
            scene, *load_test_errors(directory / "test_errors.npz"), error_unit(experiment.policy.kind)
        )
        html += page.picture(
            save_figure(figure, figures / "error_map.png"),
            "Error on held-out trajectories by place, from above and from the side.",
        )
    rows = next((path for name in TEST_ROWS if (path := directory / name).is_file()), None)
    if rows is not None:
        test = load_kinematic_test(rows)
        html += page.picture(
            save_figure(arrivals_figure(scene, test), figures / "arrivals.png"),
            f"A kinematic robot follows the policy from {len(test.start)} starts that no training has seen: arrival "
            "time over the duration of the expert's path from the same start, and how many failed.",
        )
        html += page.picture(
            save_figure(worst_paths_figure(scene, test), figures / "worst_paths.png"),
            "The worst of them: those that failed, came nearest to an obstacle, or arrived latest.",
        )
    return html


def evaluation(run_dir: pathlib.Path, experiment: Experiment, backend: str) -> tuple[str, str, Rendered | None]:
    """Figures of an evaluation.

    Returns:
        HTML of the outcomes and the episode; HTML of video and snapshots, "" without traces; how these were rendered.
    """
    scene, robot = make_scene(experiment.scene), load_robot(experiment.robot)
    figures, folder = run_dir / "figures", run_dir / "evaluation"
    rows = folder / f"{backend}.npz"
    if not rows.is_file():
        return page.paragraph(f"There is no evaluation/{backend}.npz."), "", None
    outcomes = load_outcomes(rows)
    figure = new_figure(8.0, 4.6)
    draw_outcomes(figure.add_subplot(), scene, outcomes)
    shown = page.picture(
        save_figure(figure, figures / f"outcomes_{backend}.png"),
        "Where the episodes started, and how they ended. Obstacles are brown, the target is the arrow.",
    )
    if len(outcomes.outcome) >= FEW:
        figure = new_figure(8.0, 5.4)
        draw_success_map(figure.add_subplot(), scene, outcomes)
        shown += page.picture(
            save_figure(figure, figures / f"success_{backend}.png"),
            "Starts by cell, with their number; where episodes failed, red, with how many of them did.",
        )
    found = qualities(load_columns(rows), float(robot.link_masses.sum()))
    if found:
        path = save_figure(qualities_figure(found), figures / f"qualities_{backend}.png")
        shown += page.picture(path, "How the episodes went, as cumulative distributions.")
    traces = folder / f"{backend}-traces.npz"
    episode = choose_episode(scene, load_episodes(traces, outcomes)) if traces.is_file() else None
    if episode is None:
        return shown + page.paragraph("No episode was recorded."), "", None
    figure = episode_figure(scene, episode.trace, np.asarray(robot.torque_limit))
    shown += page.picture(
        save_figure(figure, figures / f"episode_{backend}.png"),
        f"Episode {episode.row} ({episode.outcome}): height of the trunk and what is above it, speed in the plane, "
        "clearance of the torso's envelope, torques of the twelve joints.",
    )
    return shown, *_pictures(run_dir, experiment, scene, episode, backend)


def _pictures(
    run_dir: pathlib.Path, experiment: Experiment, scene: Scene, episode: Episode, backend: str
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

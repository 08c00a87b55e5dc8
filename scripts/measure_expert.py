"""What choices of the expert cost, over the paper's starts: the numbers of docs/results.md.

python scripts/measure_expert.py ends 60          u_0 = u_N = 0, by transcription
python scripts/measure_expert.py planner 200      planning in the plane against planning with the height
python scripts/measure_expert.py norm 40          the norm of the planar velocity as bound, against one bound an axis
python scripts/measure_expert.py memory 10000     resident memory over so many solves in one process (table.toml)
python scripts/measure_expert.py obstacles 24     time of a label among 1, 2, 4, 8 random obstacles
"""

import gc
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import psutil

from agile_jax.benchmark.expert import TABLE
from agile_jax.dataset.starts import draw_start
from agile_jax.experiment import load_experiment
from agile_jax.expert import ExpertSettings, compare_dimensions, make_expert
from agile_jax.scene import SceneSettings, clearance, make_scene


def spread(values, unit=""):
    """Median, 95th percentile and largest value."""
    return "median {:.4g}, p95 {:.4g}, largest {:.4g}".format(*np.quantile(values, [0.5, 0.95, 1])) + unit


def problem(path=TABLE):
    """Scene, settings and the function that draws start i."""
    experiment = load_experiment(path)
    scene, settings = make_scene(experiment.scene), experiment.expert
    return (
        scene,
        settings,
        lambda i: draw_start(scene, experiment.scene, settings, experiment.dataset, experiment.seed, i).poses[0],
    )


def measure_ends(count):
    """Relative cost of the paper's end conditions."""
    scene, settings, start = problem()
    for scheme in ("zoh", "foh", "trapezoidal"):
        free, bound = (
            make_expert(scene, settings.model_copy(update={"transcription": scheme, "zero_end_controls": ends}))
            for ends in (False, True)
        )
        costs = [bound.solve(start(i)).duration / free.solve(start(i)).duration - 1 for i in range(count)]
        print(f"{scheme}: cost {spread(costs)}")


def measure_planner(count):
    """Time that the plane loses."""
    scene, settings, start = problem()
    comparison = compare_dimensions(scene, settings, np.array([start(i) for i in range(count)]))
    solved = np.isfinite(comparison.lost)
    lost = comparison.lost[solved] / comparison.spatial[solved]
    print(f"{solved.sum()} of {count} solved by both; lost, relative: {spread(lost)}")
    print(f"lost: {spread(comparison.lost[solved], ' s')}")
    print(f"over 1 %: {(lost > 0.01).mean():.3f}, over 10 %: {(lost > 0.1).mean():.3f}")


def measure_norm(count):
    """The norm bound against bounds on each axis."""
    scene, settings, start = problem()
    labels = {}
    for bound in ("axis", "planar_norm"):
        expert = make_expert(scene, settings.model_copy(update={"velocity_bound": bound}))
        expert.solve(start(0))
        began = time.process_time()
        labels[bound] = [expert.solve(start(i)) for i in range(count)]
        seconds = (time.process_time() - began) / count
        solved = [label for label in labels[bound] if label.status == "solved"]
        attained = np.mean([label.gap < 1e-3 for label in solved])
        again = [expert.solve(start(i), guess=1 + i % 3) for i in range(min(count, 20))]
        apart = [
            abs(one.objective / other.objective - 1)
            for one, other in zip(labels[bound], again, strict=False)
            if one.status == other.status == "solved"
        ]
        print(f"{bound}: {len(solved)} of {count} solved, {1e3 * seconds:.1f} ms of processor time each")
        print(f"    attain the lower bound: {attained:.3f}; objective from another guess: {spread(apart)}")
    both = [pair for pair in zip(*labels.values(), strict=True) if all(label.status == "solved" for label in pair)]
    print(f"longer with the norm: {spread([norm.duration / axis.duration - 1 for axis, norm in both])}")
    print(f"on another branch: {sum(axis.branch != norm.branch for axis, norm in both)}")


def measure_memory(count):
    """Resident memory against the number of solves."""
    scene, settings, start = problem(Path("experiments/table.toml"))
    expert, process, methods = make_expert(scene, settings), psutil.Process(), Counter()
    for i in range(count):
        methods[expert.solve(start(i)).method] += 1
        if i + 1 in (1, 100, 500) or (i + 1) % 1000 == 0:
            kept = sum(len(o._programs) for o in gc.get_objects() if type(o).__name__ == "Ladder")
            print(f"{i + 1}: {process.memory_info().rss / 1e6:.0f} MB, {kept} programs, {dict(methods)}", flush=True)


def random_scene(count, generator):
    """Boxes and tables that may overlap, on the way from x = 0 to the target."""
    obstacles, scene = [], make_scene(SceneSettings())
    while len(obstacles) < count:
        size = generator.uniform(0.2, 0.6, 2).tolist()
        position = [float(generator.uniform(0.5, 2.3)), float(generator.uniform(-1.2, 1.2))]
        if generator.random() < 0.5:
            obstacle = {"kind": "box", "position": [*position, 0.2], "size": [*size, 0.4]}
        else:
            low = float(generator.uniform(0.2, 0.27))
            obstacle = {"kind": "table", "position": position, "size": size, "underside": low}
        try:
            scene = make_scene(SceneSettings(obstacles=[*obstacles, obstacle]))
        except ValueError:
            continue  # the target is inside
        obstacles.append(obstacle)
    return scene


def measure_obstacles(count):
    """Processor time of a label, by the number of obstacles: eight starts a scene."""
    for obstacles in (1, 2, 4, 8):
        seconds, methods = [], Counter()
        for seed in range(-(-count // 8)):
            generator = np.random.default_rng(seed)
            scene = random_scene(obstacles, generator)
            expert = make_expert(scene, ExpertSettings())
            for _ in range(8):
                pose = np.zeros(4)
                while clearance(scene, pose) < 0.03 or pose[2] == 0:
                    pose[:3] = generator.uniform([-0.6, -1.2, 0.2], [0.8, 1.2, 0.3])
                began = time.process_time()
                solution = expert.solve(pose)
                seconds.append(1e3 * (time.process_time() - began))
                methods[solution.method or solution.cause[:40]] += 1
        print(f"{obstacles} obstacles: {spread(seconds, ' ms')}, {dict(methods)}", flush=True)


if __name__ == "__main__":
    globals()[f"measure_{sys.argv[1]}"](int(sys.argv[2]))

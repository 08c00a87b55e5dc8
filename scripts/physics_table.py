"""The same robot, policy and starts in other physics: the table of docs/results.md.

python scripts/physics_table.py RUN_DIR [--episodes N] [--rows NAME ...]

RUN_DIR holds a trained policy. Results are kept beside it, in RUN_DIR-physics/mujoco-VERSION, as an evaluation keeps
them: what is there is not simulated again, and a killed run goes on. The table is of everything that is there, so that
rows made in an environment with another MuJoCo stand beside the others.

Every row has the 500 Hz torques of the experiment but the one at 250 Hz, whose torques are as slow as its physics.

MuJoCo 4, of which MJX knows nothing yet, in a folder of its own:

pip install --no-deps --target DIR mujoco==4.0.0 mujoco-core==4.0.0 mujoco-studio==4.0.0 mujoco-mjx==3.17.0
PYTHONPATH=DIR python scripts/physics_table.py RUN_DIR --rows "C, 500 Hz"
"""

import argparse
import json
import os
import pathlib
import shutil
from functools import partial

import mujoco
import numpy as np

from agile_jax.engine import open_engine
from agile_jax.evaluation import evaluate, load_traces, wilson_interval
from agile_jax.experiment import Experiment, load_experiment
from agile_jax.geometry import quaternion_to_rpy

ROWS = {  # overrides of the experiment, by section
    "C, 500 Hz": {},
    "C, 1,000 Hz": {"evaluation": {"physics": {"substeps": 2}}},
    "C, 250 Hz": {"control": {"control_dt": 0.004}},
    "C, implicitfast": {"evaluation": {"physics": {"integrator": "implicitfast"}}},
    "C, implicit": {"evaluation": {"physics": {"integrator": "implicit"}}},
    "C, Runge-Kutta": {"evaluation": {"physics": {"integrator": "rk4"}}},
    "C, elliptic cone": {"evaluation": {"physics": {"cone": "elliptic"}}},
    "MJX, 500 Hz": {"evaluation": {"backend": "mjx"}},
    "PyBullet, 1,000 Hz, rotors without reaction": {
        "evaluation": {"backend": "pybullet", "physics": {"substeps": 2, "rotor_reaction": False}}
    },
    "PyBullet, 500 Hz": {"evaluation": {"backend": "pybullet", "physics": {"substeps": 1}}},
    "PyBullet, 1,000 Hz": {"evaluation": {"backend": "pybullet", "physics": {"substeps": 2}}},
    "PyBullet, 2,000 Hz": {"evaluation": {"backend": "pybullet", "physics": {"substeps": 4}}},
}
HEAD = (
    "| physics | success | height error, rms / max [mm] | pitch, rms / max [degrees] | speed error, rms [m/s] "
    "| clearance, min / median [mm] | arrival over the expert's, median |\n|" + "---|" * 7
)


def with_row(experiment: Experiment, name: str, episodes: int) -> Experiment:
    """The experiment with a row's settings; all its episodes are recorded."""
    settings = experiment.model_dump()
    for section, values in ROWS[name].items():
        settings[section] |= values
    where = "here" if settings["evaluation"]["backend"] == "mjx" else "workers"
    settings["evaluation"] |= {"episodes": episodes, "traced": episodes, "where": where, "name": None}
    return Experiment.model_validate(settings)


def cells(summary: dict, columns: dict, traces: list) -> list[str]:
    """What the table tells of a row; errors are over all samples of all episodes, 50 a second."""
    successes, count = int(columns["success"].sum()), len(columns["success"])
    low, high = (100 * end for end in wilson_interval(successes, count))
    failures = [f"{number} {name}" for name, number in summary["failures"].items() if number]
    height = 1e3 * np.concatenate([trace.qpos[:, 2] - trace.reference[:, 2] for trace in traces])
    pitch = np.degrees(np.concatenate([quaternion_to_rpy(trace.qpos[:, 3:7])[:, 1] for trace in traces]))
    clearance, arrival = 1e3 * columns["min_clearance"], summary["arrival_time_ratio_median"]
    return [
        f"{successes} of {count} [{low:.1f}, {high:.1f}] %" + "".join(f", {failure}" for failure in failures),
        *(f"{np.sqrt(np.nanmean(values**2)):.2f} / {np.nanmax(np.abs(values)):.1f}" for values in (height, pitch)),
        f"{summary['velocity_tracking_rmse']:.4f}",
        f"{clearance.min():.1f} / {np.median(clearance):.1f}",
        "–" if arrival is None else f"{arrival:.3f}",
    ]


def simulate(run_dir: pathlib.Path, folder: pathlib.Path, name: str, episodes: int) -> None:
    """Simulate what is missing of a row, and keep its cells."""
    experiment = with_row(load_experiment(run_dir / "experiment.toml"), name, episodes)
    summary = evaluate(experiment, folder, partial(open_engine, "local", None))
    backend = experiment.evaluation.backend
    with np.load(folder / "evaluation" / f"{backend}.npz") as file:
        columns = dict(file)
    row = cells(summary, columns, load_traces(folder / "evaluation" / f"{backend}-traces.npz"))
    (folder / "rows.json").write_text(json.dumps(rows_of(folder) | {name: row}, indent=1))


def rows_of(folder: pathlib.Path) -> dict[str, list[str]]:
    """The rows that are there, of one version of MuJoCo."""
    return json.loads((folder / "rows.json").read_text()) if (folder / "rows.json").exists() else {}


def main() -> None:
    """Simulate the rows asked for, and print the table of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_dir", type=pathlib.Path)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    options = parser.parse_args()
    results = options.run_dir.with_name(options.run_dir.name + "-physics")
    folder = results / f"mujoco-{mujoco.__version__}"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(results.absolute() / "compiled"))  # of the workers
    if not (folder / "training").exists():
        shutil.copytree(options.run_dir / "training", folder / "training")
    for name in options.rows:
        print(f"{name} ...", flush=True)
        simulate(options.run_dir, folder, name, options.episodes)
    print(HEAD)
    for version in sorted(results.glob("mujoco-*")):
        for name, row in rows_of(version).items():
            print(f"| {name} ({version.name.replace('-', ' ')}) | " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()

"""The process of one trial: `python -m agile_jax.sweep.trial RUN_DIR STAGES ENGINE [WORKERS]`, started by run.py.

It ends when the sweep that started it ends, however that happens: the sweep holds the other end of its standard input.
"""

import os
import pathlib
import signal
import sys
import threading
import time

from agile_jax import pipeline
from agile_jax.experiment import load_experiment
from agile_jax.interruption import Interrupted, interruptible_progress
from agile_jax.settings import BadInput

END_TIME = 15.0  # [s] between SIGTERM and the end without ceremony


def main(run_dir: str, stages: str, engine: str, workers: str | None = None) -> int:
    """Run the stages (names joined by commas) of the experiment that stands in the run directory."""
    threading.Thread(target=_end_with_the_sweep, daemon=True).start()
    folder = pathlib.Path(run_dir)
    try:
        experiment = load_experiment(folder / "experiment.toml")
        with interruptible_progress() as progress:
            results = pipeline.run(
                experiment,
                folder,
                stages.split(","),
                engine=engine,
                store=folder.absolute().parents[2] / ".store",  # beside the sweep
                workers=None if workers is None else int(workers),
                progress=progress,
            )
    except (BadInput, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    except Interrupted as error:
        print(f"ended by {error}", file=sys.stderr)
        return 128 + error.number
    found = pipeline.failures(results)
    print("\n".join(found), file=sys.stderr)
    return 1 if found else 0


def _end_with_the_sweep() -> None:
    os.read(sys.stdin.fileno(), 1)  # nothing is ever written: this returns when the sweep has closed its end
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(END_TIME)
    os._exit(143)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

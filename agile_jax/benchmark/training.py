"""`agile benchmark training`: the training's floating-point rate against the machine's, and against PyTorch.

All do the steps of stochastic gradient descent that a training does, on the same network with tanh, the same initial
parameters, samples and order; only matrix products are counted. `products` are those of a step, one by one as
jnp.matmul computes them in float32: the rate at which this machine multiplies matrices of these shapes through the
same library. PyTorch runs in a process of its own. The methods take turns; rates are medians over the repetitions, and
ratios medians of the ratios within each, because the speed of a shared machine changes from second to second.
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from agile_jax.benchmark.measuring import Spent, machine, timed, versions
from agile_jax.benchmark.metrics import Metric, Result, as_json, comparison, text_of
from agile_jax.experiment import Experiment
from agile_jax.progress import Progress, silent
from agile_jax.settings import BadInput
from agile_jax.store.npz import write_npz

if TYPE_CHECKING:
    from agile_jax.benchmark.workloads.throughput import Run, Workload
    from agile_jax.training.precision import Precision

METHOD = " ".join((__doc__ or "").partition("\n\n")[2].split())
PAUSE = 0.02  # [s] between two methods: threads of the one before stop spinning
SHARE_TARGET, PEER_TARGET = 0.85, 1.0
PLAIN_TARGET = 1.03  # below it, training/precision.py is not worth its lines
METHODS = {
    "ours_float32": "make_epoch of the training, precision float32",
    "ours_bfloat16": "the same, precision bfloat16: operands rounded, summed and kept in float32",
    "plain_float32": "the training's steps with the layers' own products, as Flax multiplies them in float32",
    "products": "the products of a step in float32, one by one, without anything between them",
    "torch_float32": "PyTorch as it comes",
    "torch_bfloat16": "PyTorch with autocast",
    "torch_products": "one product of PyTorch at the widest layer's shape, float32",
}


class Timing(NamedTuple):
    """One repetition of one method."""

    spent: Spent
    losses: list[float]  # by step, where there are any


def benchmark_training(
    experiment: Experiment, steps: int = 4, repetitions: int = 20, progress: Progress = silent
) -> Result:
    """Measure, and return what goes into the JSON file: `metrics` by key and the method.

    Args:
        experiment: its hidden layers, batch size, learning rate and initialisation are used.
        steps: in each repetition.
        repetitions: of each method.
        progress: is told of each.

    Raises:
        BadInput: no steps or repetitions, or another activation than tanh.
    """
    from agile_jax.benchmark.workloads import throughput

    if min(steps, repetitions) < 1:
        raise BadInput(f"steps = {steps} and repetitions = {repetitions} must be at least 1")
    if experiment.policy.activation != "tanh":
        raise BadInput(f'policy.activation = "{experiment.policy.activation}": this benchmark knows only "tanh"')
    progress("compiling", 0, repetitions)
    workload, compiled = throughput.make_workload(experiment.policy, experiment.training, steps)
    products = throughput.make_products(workload)
    product_seconds: dict[str, list[float]] = {product.name: [] for product in products}
    flops = steps * throughput.step_flops(workload)
    kinds: dict[str, Precision | None] = {"ours_float32": "float32", "ours_bfloat16": "bfloat16", "plain_float32": None}
    methods = {name: _timed(compiled(precision)) for name, precision in kinds.items()}

    def all_products() -> Timing:
        spent = [timed(product.run)[1] for product in products]
        for product, its in zip(products, spent, strict=True):
            product_seconds[product.name].append(its.wall)
        return Timing(Spent(sum(its.wall for its in spent), sum(its.cpu for its in spent)), [])

    methods["products"] = all_products
    with _torch(workload) as peer:
        if peer is not None:
            methods |= {f"torch_{name}": partial(peer, name) for name in ("float32", "bfloat16", "products")}
        timings: dict[str, list[Timing]] = {name: [] for name in methods}
        for i in range(repetitions + 1):  # the first warms up
            for name, run in methods.items():
                time.sleep(PAUSE)
                found = run()
                if i > 0:
                    timings[name].append(found)
            progress("measuring", i, repetitions, "repetitions")
    work = dict.fromkeys(methods, flops) | {"products": sum(product.flops for product in products)}
    work["torch_products"] = 2.0 * workload.rows.shape[1] * max(kernel.size for kernel in workload.kernels)
    return {
        "benchmark": "training",
        "experiment": experiment.name,
        "method": METHOD,
        "methods": METHODS | ({} if peer is not None else dict.fromkeys(_peers(), "not installed: pip install torch")),
        "problem": {
            "hidden_layers": list(experiment.policy.hidden_layers),
            "batch": experiment.training.batch_size,
            "steps": steps,
            "repetitions": repetitions,
            "gflop_per_step": flops / steps / 1e9,
        },
        "machine": machine(),
        "software": versions("agile_jax", "jax", "jaxlib", "torch"),
        "metrics": as_json(_metrics(timings, work)),
        # [GFLOP/s]
        "products": {p.name: p.flops / float(np.median(product_seconds[p.name])) / 1e9 for p in products},
    }


def _timed(run: "Run") -> Callable[[], Timing]:
    def repetition() -> Timing:
        losses, spent = timed(run.work, run.prepare())
        return Timing(spent, losses.tolist())

    return repetition


def _peers() -> list[str]:
    return [name for name in METHODS if name.startswith("torch")]


@contextmanager
def _torch(workload: "Workload") -> Iterator[Callable[[str], Timing] | None]:
    """Ask PyTorch in its own process to do the work in a precision; None where it is not installed."""
    if find_spec("torch") is None:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="agile-torch-") as folder:
        path = pathlib.Path(folder) / "workload.npz"
        arrays = {f"kernel_{i}": kernel for i, kernel in enumerate(workload.kernels)}
        arrays |= {f"bias_{i}": bias for i, bias in enumerate(workload.biases)}
        arrays |= {"poses": workload.poses, "labels": workload.labels, "rows": workload.rows.astype(np.int64)}
        arrays |= {"layers": np.array(len(workload.kernels)), "learning_rate": np.array(workload.learning_rate)}
        write_npz(path, arrays)
        command = [sys.executable, "-m", "agile_jax.benchmark.peers.torch_peer", str(path)]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert process.stdin is not None
        assert process.stdout is not None

        def ask(name: str) -> Timing:
            print(name, file=process.stdin, flush=True)
            line = process.stdout.readline()  # type: ignore[union-attr]
            if not line:
                raise RuntimeError(f"PyTorch's process ended with code {process.wait()}")
            answer = json.loads(line)
            return Timing(Spent(answer["wall"], answer["cpu"]), answer["losses"])

        try:
            yield ask
        finally:
            process.stdin.close()
            process.wait()
            process.stdout.close()


def _metrics(timings: dict[str, list[Timing]], work: dict[str, float]) -> list[Metric]:
    """Rates of each method [GFLOP/s], and ours against the machine and the peer.

    Args:
        timings: of each method, by repetition.
        work: floating-point operations of one repetition of each method.
    """
    walls = {name: work[name] / np.array([timing.spent.wall for timing in found]) for name, found in timings.items()}
    cpus = {name: work[name] / np.array([timing.spent.cpu for timing in found]) for name, found in timings.items()}

    def ratio(rates: dict[str, np.ndarray], name: str, other: str) -> float:
        return float(np.median(rates[name] / rates[other]))

    found = []
    for name in timings:
        meaning = "over the processor time of all threads"
        found += [
            Metric(f"{name}.rate", float(np.median(walls[name])) / 1e9, "GFLOP/s", "higher", "over wall time"),
            Metric(f"{name}.rate_per_core_second", float(np.median(cpus[name])) / 1e9, "GFLOP/s", "higher", meaning),
        ]
    share, cpu_share = (ratio(rates, "ours_float32", "products") for rates in (walls, cpus))
    bfloat16 = ratio(walls, "ours_bfloat16", "ours_float32")
    over_plain = ratio(walls, "ours_float32", "plain_float32")
    found += [
        Metric("ours_float32.of_products", share, "", "higher", "its rate over the products'", SHARE_TARGET),
        Metric("ours_float32.of_products_per_core_second", cpu_share, "", "higher", "the same over processor time"),
        Metric("ours_bfloat16.over_float32", bfloat16, "", "higher", "its rate over float32's"),
        Metric("ours_float32.over_plain", over_plain, "", "higher", "over the layers' own products'", PLAIN_TARGET),
    ]
    if "torch_float32" in timings:
        theirs, ours = (np.array(timings[name][-1].losses) for name in ("torch_float32", "ours_float32"))
        differ = np.abs(theirs / ours - 1).max()
        float32, reduced = (ratio(walls, f"ours_{kind}", f"torch_{kind}") for kind in ("float32", "bfloat16"))
        meaning = "its rate over PyTorch's"
        found += [
            Metric("ours_float32.over_torch", float32, "", "higher", f"{meaning} float32", PEER_TARGET),
            Metric("ours_bfloat16.over_torch", reduced, "", "higher", f"{meaning} bfloat16"),
            Metric("torch_float32.loss_difference", float(differ), "", "lower", "largest relative, of a step's loss"),
        ]
    return found


def report(result: Result) -> str:
    """The result as a table to read."""
    metrics = result["metrics"]
    names = [name for name in METHODS if f"{name}.rate" in metrics]
    missing = [f"{name}: {text}" for name, text in result["methods"].items() if text.startswith("not installed")]
    return text_of(result, comparison(metrics, names), *missing)

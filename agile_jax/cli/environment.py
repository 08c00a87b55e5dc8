"""What the program sets and checks in its environment before the libraries read it. The package itself does neither."""

import os
import pathlib
import subprocess
import sys

from agile_jax.settings import BadInput


def prepare_libraries() -> None:
    """Set flags of JAX and BLAS for this process and its children, before anything imports them.

    Compile once for all runs. One thread for the small factorisations of the controller: more are slower, and the last
    digits of a result would depend on the number of cores.
    """
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ and (cache := _cache_folder()):
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(cache / "agile_jax" / "jax")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
    os.environ.setdefault("JAX_ENABLE_X64", "0")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _cache_folder() -> pathlib.Path | None:
    """The user's folder for caches; None where there is none, and then every run compiles anew."""
    if named := os.environ.get("XDG_CACHE_HOME"):
        return pathlib.Path(named)
    try:
        return pathlib.Path.home() / ".cache"
    except RuntimeError:
        return None


def check_opengl() -> None:
    """Make sure that mujoco can be imported: it reads MUJOCO_GL on import, and fails where that does not work.

    A way of rendering that does not work here is named and dropped, since only pictures need one.

    Raises:
        BadInput: MUJOCO_GL is none of MuJoCo's words.
    """
    value = os.environ.get("MUJOCO_GL", "").strip()
    if not value:
        return
    probe = subprocess.run(
        [sys.executable, "-c", "import mujoco"], stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    if probe.returncode == 0:
        return
    complaint = [line.strip() for line in probe.stderr.splitlines() if line.strip()][-1:] or ["no reason given"]
    if "invalid value" in complaint[0]:
        raise BadInput(
            f"MUJOCO_GL = {value!r} in the environment is none of MuJoCo's words; unset it, or use egl, osmesa, glfw "
            "or disable"
        )
    print(f"agile: MUJOCO_GL={value} does not work here ({complaint[0]}); going on without it", file=sys.stderr)
    del os.environ["MUJOCO_GL"]


def use_one_thread(one_core: bool = False) -> None:
    """One thread for the numerical libraries of this process, before anything imports them: for benchmarks per core.

    Args:
        one_core: hold the process to one core as well, where the system can: JAX starts threads all the same.
    """
    from agile_jax.engine import THREADS

    os.environ.update(THREADS)
    if one_core and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    flags = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1".strip()

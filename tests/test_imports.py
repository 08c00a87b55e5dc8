"""The order of imports and the one home of each heavy library (docs/architecture.md), read from the source."""

import ast
import pathlib
import subprocess
import sys

import pytest

PACKAGE = pathlib.Path(__file__).parents[1] / "agile_jax"
MODULES = sorted(PACKAGE.rglob("*.py"))

LEAVES = {"settings", "arrays", "files", "geometry", "plugins", "progress", "single_precision", "engine", "store"}
STAGES = ["scene", "expert", "dataset", "policy", "training", "robot", "control", "simulation", "evaluation", "report"]

HOMES = {  # where a heavy library may be imported; folders and files of the package
    "casadi": {"expert", "benchmark"},
    **{
        peer: {"benchmark"} for peer in ("rockit", "clarabel", "daqp", "osqp", "piqp", "proxsuite", "quadprog", "torch")
    },
    "scipy": {"benchmark", "evaluation", "report"},
    "orbax": {"training/checkpoint.py"},
    "flax": {"policy", "training"},
    "optax": {"training", "benchmark"},
    "tensorboardX": {"training"},
    "matplotlib": {"report", "api"},  # the latter for the type of Axes
    "mpl_toolkits": {"report"},
    "imageio": {"report"},
    "imageio_ffmpeg": {"report"},
    "PIL": {"report"},
    "mujoco": {"robot", "simulation", "report", "benchmark"},
    "pybullet": {"simulation"},
    "dask": {"engine"},
    "distributed": {"engine"},
}
WITHOUT_JAX = {
    "scene",
    "expert",
    "dataset",
    "store",
    "experiment",
    "sweep",
    "study",
    "api",
    "cli",
}  # and every module at the top of the package but single_precision.py


def imported(path: pathlib.Path) -> set[str]:
    """Full names of the modules that a file imports anywhere, also inside functions and for the type checker."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            names.add(node.module)
            if node.module == "agile_jax":
                names |= {f"agile_jax.{alias.name}" for alias in node.names}
    return names


def part(path: pathlib.Path) -> str:
    """The stage's folder, or the name of a module at the top."""
    inside = path.relative_to(PACKAGE)
    return inside.parts[0] if len(inside.parts) > 1 else inside.stem


def own_parts(path: pathlib.Path) -> set[str]:
    return {name.split(".")[1] for name in imported(path) if name.startswith("agile_jax.")}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_left(path: pathlib.Path) -> None:
    mine, others = part(path), own_parts(path) - {part(path)}
    if mine in LEAVES:
        assert others <= LEAVES
    elif mine == "control":
        assert others <= LEAVES | {"robot"}
    elif mine in STAGES:
        # A stage's settings are a part of the experiment, and its work reads the whole of it.
        reads = set() if path.name == "settings.py" else {"experiment"}
        assert others <= LEAVES | reads | set(STAGES[: STAGES.index(mine)])
    elif path.relative_to(PACKAGE).as_posix() in ("sweep/settings.py", "sweep/numbers.py"):
        assert others <= LEAVES
    elif path.relative_to(PACKAGE).as_posix() == "study/settings.py":
        assert others <= LEAVES | {"sweep"}
    elif mine == "experiment" and path.name != "check.py":  # composes settings, and nothing else of a stage
        of_stages = {name for name in imported(path) if name.startswith("agile_jax.") and name.split(".")[1] in STAGES}
        checks = {"agile_jax.robot.envelope", "agile_jax.expert.feasible_poses", "agile_jax.control.top_speed"}
        assert all(name.endswith(".settings") or name in checks for name in of_stages)
    elif mine != "cli":
        assert "cli" not in others


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_heavy_libraries_have_one_home(path: pathlib.Path) -> None:
    inside = path.relative_to(PACKAGE)
    for library in {name.split(".")[0] for name in imported(path)} & set(HOMES):
        assert {inside.as_posix(), inside.parts[0]} & HOMES[library], f"{inside} imports {library}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_jax_stays_out_of_the_light_parts(path: pathlib.Path) -> None:
    inside = path.relative_to(PACKAGE)
    light = inside.name == "settings.py" or len(inside.parts) == 1 or inside.parts[0] in WITHOUT_JAX
    if light and inside.as_posix() != "single_precision.py":
        assert not {name.split(".")[0] for name in imported(path)} & {"jax", "jaxlib", "flax", "optax", "orbax"}


def test_the_checks_see_something() -> None:
    assert len(MODULES) > 50
    libraries = {name.split(".")[0] for path in MODULES for name in imported(path)}
    assert {"casadi", "orbax", "matplotlib", "mujoco", "distributed", "jax"} <= libraries


def loaded(statement: str) -> set[str]:
    """The top-level modules that a fresh interpreter holds after a statement."""
    program = f"import sys\n{statement}\nprint(*{{name.split('.')[0] for name in sys.modules}})"
    return set(
        subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    )


def test_the_light_packages_load_no_jax() -> None:
    parts = ["benchmark", "expert", "dataset", "engine", "experiment", "sweep", "study"]
    packages = ", ".join(["agile_jax", *(f"agile_jax.{part}" for part in parts)])
    assert not loaded(f"import {packages}") & {"jax", "mujoco", "matplotlib", "optax", "orbax"}


def test_importing_the_package_loads_nothing() -> None:
    assert not loaded("import agile_jax") & {"numpy", "pydantic", "jax"}


def test_a_lazy_name_is_the_object_of_its_module() -> None:
    statement = (
        "import agile_jax.evaluation as e\nfirst = e.rollout_one\n"
        "from agile_jax.evaluation.single import rollout_one\nassert first is e.rollout_one is rollout_one"
    )
    assert "jax" in loaded(statement)

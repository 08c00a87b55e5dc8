"""The command line as a process: signals, full disks, pipes that close, what it loads."""

import os
import pathlib
import resource
import signal
import subprocess
import sys
import time

import pytest

from agile_jax.cli import main

BASE = pathlib.Path(__file__).parents[1] / "experiments" / "base.toml"
SMALL = ["--dataset.trajectories", "4", "--dataset.shard-size", "1", "--expert.nodes", "20", "--engine", "inline"]


@pytest.fixture
def folder(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    """The working directory of a test, with an experiment file in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "good.toml").write_text(f'extends = "{BASE}"\nname = "n"\n')
    return tmp_path


def agile(*arguments: str, **options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "agile_jax.cli", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)  # type: ignore[call-overload,no-any-return]


def test_a_full_disk_is_one_line_and_the_run_goes_on_later(folder: pathlib.Path) -> None:
    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (6000, 6000))

    process = agile("expert", "good.toml", *SMALL, preexec_fn=small_files)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in err
    assert "agile: " in err
    assert "File too large" in err
    assert not (folder / "runs/n/dataset/summary.json").exists()
    process = agile("expert", "good.toml", *SMALL)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "4 trajectories" in out


@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGTERM, 143, "terminated"), (signal.SIGINT, 130, "interrupted")]
)
def test_signals_end_cleanly_with_the_children(
    number: signal.Signals, code: int, word: str, folder: pathlib.Path
) -> None:
    many = ["--dataset.trajectories", "100000", "--dataset.shard-size", "2", "--expert.nodes", "20", "--workers", "1"]
    process = agile("expert", "good.toml", *many)
    deadline = time.monotonic() + 60
    while not list(folder.glob("runs/n/dataset/shard-*")) and time.monotonic() < deadline:
        time.sleep(0.05)
    children = descendants(process.pid)
    assert children  # the worker
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == code
    assert err.splitlines()[-1] == f"agile: {word}; the same command goes on where this one stopped"
    assert "Traceback" not in err
    deadline = time.monotonic() + 10
    while any(alive(child) for child in children) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(alive(child) for child in children)


def descendants(pid: int) -> list[int]:
    """All processes below one (Linux)."""
    found = []
    for path in pathlib.Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            child = int(path.parent.name)
            found += [child, *descendants(child)]
    return found


def alive(pid: int) -> bool:
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_reader_that_leaves_is_no_error(folder: pathlib.Path) -> None:
    process = agile("schema")
    assert process.stdout is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.wait(30) == 0
    assert process.stderr is not None
    assert process.stderr.read() == ""


def test_the_light_commands_load_no_jax(folder: pathlib.Path) -> None:
    # How low and fast the robot can crouch is worked out from its file, which MuJoCo reads.
    for arguments, heavy in (
        (["--help"], {"jax", "mujoco", "matplotlib", "casadi"}),
        (["schema"], {"jax", "mujoco", "matplotlib", "casadi"}),
        (["run", "good.toml", "--dry-run"], {"jax", "matplotlib", "casadi"}),
    ):
        program = (
            "import sys\nfrom agile_jax.cli import main\n"
            f"assert main({arguments!r}) == 0\n"
            f"assert not {heavy} & set(sys.modules)"
        )
        subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL, env=dict(os.environ))


def test_the_number_of_cores_changes_no_digit(folder: pathlib.Path) -> None:
    """The commands give BLAS one thread before anything loads it, unless the user has said otherwise."""
    program = (
        "import os, sys\nfrom agile_jax.cli import main\n"
        "assert main(['run', 'good.toml', '--dry-run']) == 0\nprint(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    bare = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    for environment, expected in ((bare, "1"), (bare | {"OPENBLAS_NUM_THREADS": "2"}, "2")):
        ended = subprocess.run(
            [sys.executable, "-c", program], check=True, capture_output=True, text=True, env=environment
        )
        assert ended.stdout.splitlines()[-1] == expected


def test_a_device_that_fails_is_one_line(folder: pathlib.Path, monkeypatch, capsys) -> None:
    import jax

    from agile_jax import pipeline

    def lost(*_, **__):
        raise jax.errors.JaxRuntimeError("INTERNAL: CUDA_ERROR_ECC_UNCORRECTABLE: uncorrectable\nmore")

    monkeypatch.setattr(pipeline, "run", lost)
    assert main(["run", "good.toml"]) == 1
    said = capsys.readouterr().err
    assert "the device failed: INTERNAL: CUDA_ERROR_ECC_UNCORRECTABLE: uncorrectable; what was finished is kept" in said

"""MuJoCo's own renderer, in a process of its own because MUJOCO_GL must be set before mujoco is imported.

    python -m agile_jax.report.video.opengl FOLDER < /dev/null > frames.rgb

FOLDER holds model.mjb and shot.npz (qpos, look_at, size). The pictures go to standard output as raw RGB, one after the
other, so that the caller encodes while the next one is rendered.
"""

import os
import pathlib
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from typing import IO

import mujoco
import numpy as np

from agile_jax.report.video.camera import AZIMUTH, ELEVATION, FIELD_OF_VIEW, SEE_THROUGH, VIEW_HEIGHT, Picture, Shot
from agile_jax.store.npz import read_npz, write_npz

DISABLED = ("0", "disable", "disabled", "false", "off")  # MuJoCo's words for "no rendering"
SYSTEM_PACKAGES = "apt-get install -y --no-install-recommends libegl1 libgl1 libgl1-mesa-dri libosmesa6"
_TIMEOUT = 300.0  # [s] of one shot


class RenderError(RuntimeError):
    """This way of rendering does not work here; the text is the last line of its complaint."""


def candidates(environment: Mapping[str, str], platform: str = sys.platform) -> tuple[str, ...]:
    """Values of MUJOCO_GL to try, in order: the user's own if there is one."""
    own = environment.get("MUJOCO_GL", "").strip().lower()
    if own in DISABLED:
        return ()
    if own:
        return (own,)
    return ("egl", "osmesa") if platform.startswith("linux") else ("glfw",)


def opengl_frames(model: mujoco.MjModel, shot: Shot, width: int, height: int, backend: str) -> Iterator[Picture]:
    """The pictures of a shot, rendered with MUJOCO_GL=`backend`.

    Raises:
        RenderError: the backend does not work here, or its process died; some pictures may have come before.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        mujoco.mj_saveModel(model, str(folder / "model.mjb"), None)
        write_npz(folder / "shot.npz", {"qpos": shot.qpos, "look_at": shot.look_at, "size": np.array([width, height])})
        command = [sys.executable, "-m", "agile_jax.report.video.opengl", str(folder)]
        environment = {**os.environ, "MUJOCO_GL": backend}
        with open(folder / "errors.txt", "w+b") as errors:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors, env=environment
            )
            watchdog = threading.Timer(_TIMEOUT, process.kill)  # a driver may hang
            watchdog.start()
            try:
                assert process.stdout is not None
                for _ in range(len(shot.qpos)):
                    picture = process.stdout.read(width * height * 3)
                    if len(picture) < width * height * 3:
                        process.wait()
                        raise RenderError(_complaint(errors, process.returncode))
                    yield np.frombuffer(picture, np.uint8).reshape(height, width, 3)
            finally:
                watchdog.cancel()
                process.kill()
                process.wait()
                if process.stdout is not None:
                    process.stdout.close()


def _complaint(errors: IO[bytes], code: int) -> str:
    errors.seek(0)
    lines = [line.strip() for line in errors.read().decode(errors="replace").splitlines() if line.strip()]
    return lines[-1].split(": ", 1)[-1][:80] if lines else f"the rendering process ended with {code}"


def _render(folder: pathlib.Path) -> None:
    """The child's work: write every picture of the shot to standard output."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a driver prints must not land between the pictures
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    shot = read_npz(folder / "shot.npz")
    width, height = (int(size) for size in shot["size"])
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.global_.fovy = FIELD_OF_VIEW
    model.vis.quality.offsamples = 0  # software OpenGL is several times slower with multisampling
    fixed = (model.geom_bodyid == 0) & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    model.geom_rgba[fixed, 3] = np.minimum(model.geom_rgba[fixed, 3], SEE_THROUGH)
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.azimuth, camera.elevation = AZIMUTH, ELEVATION
    camera.distance = VIEW_HEIGHT / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    renderer = mujoco.Renderer(model, height, width)
    try:
        for configuration, point in zip(shot["qpos"], shot["look_at"], strict=True):
            data.qpos[:] = configuration
            mujoco.mj_forward(model, data)
            camera.lookat[:] = point
            renderer.update_scene(data, camera)
            for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
                renderer.scene.flags[flag] = 0
            output.write(renderer.render().tobytes())
        output.close()
    finally:
        renderer.close()


if __name__ == "__main__":
    _render(pathlib.Path(sys.argv[1]))

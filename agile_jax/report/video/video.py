"""The video of an episode and its snapshots: OpenGL where there is one, a plain drawing elsewhere."""

import itertools
import os
import pathlib
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from typing import NamedTuple

import imageio_ffmpeg  # type: ignore[import-untyped]
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from agile_jax.files import temporary_name
from agile_jax.report.figures.motions import Recorded
from agile_jax.report.settings import ReportSettings
from agile_jax.report.video.camera import Picture, Shot, film
from agile_jax.report.video.drawing import drawn_frames
from agile_jax.report.video.opengl import SYSTEM_PACKAGES, RenderError, candidates, opengl_frames
from agile_jax.robot import RobotSettings, build_mujoco_model
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.settings import BadInput

SIM_DT = 0.002  # [s] of the model that is drawn; nothing is simulated


class Rendered(NamedTuple):
    """How pictures were made."""

    renderer: str  # "egl", "osmesa", ..., or "drawing"
    note: str | None  # one line on what would make them better


def render_video(
    scene: SceneSettings,
    robot: RobotSettings,
    trace: Recorded,
    path: pathlib.Path,
    settings: ReportSettings | None = None,
) -> str | None:
    """Render a trace to an mp4 in real time.

    Args:
        scene, robot: what the physics ran with.
        trace: a recorded episode.
        path: of the mp4.
        settings: size and rate of the pictures.

    Returns:
        None, or one line: why the pictures are drawings, and what to install for rendered ones.

    Raises:
        BadInput: the trace is empty or does not fit the robot.
    """
    settings = settings or ReportSettings()
    model = build_mujoco_model(make_scene(scene), robot, SIM_DT)
    shot = film(np.asarray(trace.time), np.asarray(trace.qpos), settings.frames_per_second, settings.longest_video)
    return render_shot(model, shot, settings, lambda frames: write_mp4(path, frames, settings.frames_per_second)).note


def render_shot(
    model: mujoco.MjModel, shot: Shot, settings: ReportSettings, consume: Callable[[Iterator[Picture]], object]
) -> Rendered:
    """Make the pictures of a shot with the first renderer that works, and hand them to `consume`.

    `consume` gets an iterator of pictures; it is called anew if a renderer fails on the way.

    Raises:
        BadInput: the shot is empty or does not fit the model.
    """
    if len(shot.qpos) == 0 or shot.qpos.shape[1] != model.nq:
        raise BadInput(f"the trace has shape {shot.qpos.shape}; the robot needs (moments >= 1, {model.nq})")
    failures = []
    backends = () if settings.renderer == "drawing" else candidates(os.environ)
    for backend in backends:
        try:
            consume(_with_captions(opengl_frames(model, shot, settings.width, settings.height, backend), shot.captions))
            return Rendered(backend, None)
        except RenderError as error:
            failures.append(f"{backend}: {error}")
    consume(_with_captions(drawn_frames(model, shot, settings.width, settings.height), shot.captions))
    note = None
    if failures:
        note = f"No OpenGL ({'; '.join(failures)}); pictures are plain drawings. For rendered ones: {SYSTEM_PACKAGES}"
    return Rendered("drawing", note)


def write_mp4(path: pathlib.Path, frames: Iterator[Picture], frames_per_second: int) -> None:
    """Encode pictures as H.264 that browsers play, and move the finished file into place.

    The encoder is the one that the wheel of imageio-ffmpeg brings. It is started here and not by imageio, whose fork
    would run Python in a child of a process that has JAX's threads.

    Raises:
        OSError: the encoder failed or the disk is full.
    """
    first = next(frames)
    height, width = first.shape[:2]
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_name(path)
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(frames_per_second), "-i", "-"]
    coding = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-preset", "veryfast", "-crf", "25", "-threads", "1"]
    layout = ["-movflags", "+faststart", "-fflags", "+bitexact", "-map_metadata", "-1", "-f", "mp4"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-y", *source, *coding, *layout, str(temporary)]
    with tempfile.TemporaryFile() as errors:
        encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors)
        try:
            assert encoder.stdin is not None
            try:
                for frame in itertools.chain([first], frames):
                    encoder.stdin.write(frame.tobytes())
                encoder.stdin.close()
            except BrokenPipeError:
                pass  # the encoder ended early; its exit status and complaint follow
            if encoder.wait() != 0:
                errors.seek(0)
                raise OSError(f"{path} could not be encoded: {errors.read().decode(errors='replace').strip()[-300:]}")
            os.replace(temporary, path)
        finally:
            encoder.kill()
            encoder.wait()
            temporary.unlink(missing_ok=True)


def _with_captions(frames: Iterator[Picture], captions: list[str]) -> Iterator[Picture]:
    for frame, caption in zip(frames, captions, strict=True):
        image = Image.fromarray(frame)
        pen = ImageDraw.Draw(image, "RGBA")
        font = ImageFont.load_default(size=max(12, image.height // 22))
        box = pen.textbbox((12, 10), caption, font=font)
        pen.rectangle((box[0] - 6, box[1] - 5, box[2] + 6, box[3] + 5), fill=(255, 255, 255, 190))
        pen.text((12, 10), caption, fill=(34, 34, 34), font=font)
        yield np.asarray(image)

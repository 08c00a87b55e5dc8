"""The files of a robot of its own MJCF: what they say, told by content, and their copy in a run directory."""

import hashlib
import os
import pathlib
import shutil

import mujoco
import numpy as np

from agile_jax.robot.mjcf import robot_spec
from agile_jax.robot.settings import OWN, RobotSettings

DIGITS = 40  # bits of a number that count: compilers round the last ones of 53 differently


def robot_digest(settings: RobotSettings) -> str | None:
    """The sha256 of the robot's compiled model, wherever its files are; None for the package's own robot.

    It covers every array of the model that is simulated, floats to twelve digits: what an included file or a mesh says,
    but no comment or path.

    Raises:
        BadInput: the MJCF cannot be used; with the reason.
    """
    if settings.name == OWN:
        return None
    model, digest = robot_spec(settings).compile(), hashlib.sha256()
    for name in dir(model):
        values = getattr(model, name, None)
        if not isinstance(values, np.ndarray) or name.startswith("bvh_"):  # found from the others, and large
            continue
        if values.dtype.kind == "f":
            mantissa, exponent = np.frexp(np.nan_to_num(values.astype(float)))
            values = np.stack([np.rint(np.ldexp(mantissa, DIGITS)).astype(np.int64), exponent.astype(np.int64)])
        digest.update(f"{name} {values.shape} {values.dtype.str}".encode())
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def copy_robot(settings: RobotSettings, folder: pathlib.Path) -> RobotSettings:
    """Copy the robot's MJCF with all files that it needs into `folder`; what is there is replaced.

    Returns:
        The settings with the copy's path, or as they are for the package's own robot.
    """
    if settings.name == OWN:
        return settings
    main = pathlib.Path(os.path.abspath(settings.name))
    files = {pathlib.Path(os.path.abspath(name)) for name in mujoco.mju_getXMLDependencies(str(main))} | {main}
    base = pathlib.Path(os.path.commonpath([file.parent for file in files]))
    folder = pathlib.Path(os.path.abspath(folder))
    copied = folder / main.relative_to(base)
    if copied != main:
        fresh = folder.with_name(f".{folder.name}.new")
        shutil.rmtree(fresh, ignore_errors=True)
        for file in sorted(files):
            place = fresh / file.relative_to(base)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, place)
        shutil.rmtree(folder, ignore_errors=True)
        fresh.rename(folder)
    return settings.model_copy(update={"name": str(copied)})

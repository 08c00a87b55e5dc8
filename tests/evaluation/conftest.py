"""These tests also use the quadruped of the robot's tests."""

import pathlib
import sys

sys.path.append(str(pathlib.Path(__file__).parents[1] / "robot"))

"""Names and order of legs and joints: legs FR, FL, RR, RL; joints abad, hip, knee."""

import numpy as np

LEG_NAMES = ("FR", "FL", "RR", "RL")
JOINT_NAMES = ("abad", "hip", "knee")  # of one leg: about x, about y, about y
FRONT = np.array([1.0, 1.0, -1.0, -1.0])  # (4,) +1 for a front leg
LEFT = np.array([-1.0, 1.0, -1.0, 1.0])  # (4,) +1 for a left leg

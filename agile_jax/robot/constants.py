"""Names and order of legs and joints: legs FR, FL, RR, RL; joints abad, hip, knee. And gravity."""

from itertools import product

import numpy as np

GRAVITY = 9.81  # [m/s^2]
LEG_NAMES = ("FR", "FL", "RR", "RL")
JOINT_NAMES = ("abad", "hip", "knee")  # of one leg: about x, about y, about y
BOX_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))  # (8, 3) of a box of half sizes 1

"""Closed-loop episodes: the loop of one robot, its outcome, and the physics that drive many robots at once.

`closed_loop.py` composes what is followed, reference, controller and outcome; `plan_cycle.py` is the loop over time;
`mujoco_*.py`, `mjx_*.py` and `bullet/` are the physics; `streaming.py` runs any number of episodes through them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The contact flags against the list of contacts, by brute force."""

import mujoco
import numpy as np

from agile_jax.simulation.sensed import contact_flags, touch_slots


def flags_by_brute_force(model, data) -> tuple[bool, bool]:
    obstacle = floor = False
    for contact in data.contact:
        names = {model.geom(int(geom)).name for geom in contact.geom}
        if contact.dist >= 0 or names <= {"floor", "obstacle_0"}:
            continue
        obstacle |= "obstacle_0" in names
        upper = [name for name in names if name.startswith("trunk") or name.endswith(("_hip", "_thigh", "_thigh_back"))]
        floor |= "floor" in names and bool(upper)
    return obstacle, floor


def test_flags_are_those_of_the_contact_list(model):
    generator = np.random.default_rng(0)
    data = mujoco.MjData(model)
    slots = touch_slots(model)
    expected, actual = [], []
    for _ in range(400):
        data.qpos[:3] = generator.uniform([0.3, -0.8, 0.03], [1.7, 0.8, 0.6])
        data.qpos[3:7] = generator.normal([1.0, 0.0, 0.0, 0.0], 0.3)
        data.qpos[7:] = generator.uniform(*model.jnt_range[1:].T)
        mujoco.mj_forward(model, data)
        expected.append(flags_by_brute_force(model, data))
        actual.append(contact_flags(data.sensordata, slots)[:2])
    np.testing.assert_array_equal(actual, expected)
    share = np.mean(expected, 0)
    assert (share > 0.1).all()
    assert (share < 0.9).all()


def test_flags_keep_batch_axes(model):
    slots = touch_slots(model)
    sensordata = np.zeros((3, 2, model.nsensordata))
    sensordata[1, 0, slots.obstacle] = 2.0
    sensordata[2, 1, np.flatnonzero(slots.floor)[3]] = 1.0
    obstacle, floor, _ = contact_flags(sensordata, slots)
    np.testing.assert_array_equal(obstacle, [[False, False], [True, False], [False, False]])
    np.testing.assert_array_equal(floor, [[False, False], [False, False], [False, True]])

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.scene import SceneSettings, make_scene

TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.5, 1.0], "underside": 0.25}
PAPER_START = np.array([0.0, 0.0, 0.28, 0.0])


@pytest.fixture(scope="session")
def scene():
    return make_scene(SceneSettings(obstacles=[TABLE]))


@pytest.fixture(scope="session")
def settings():
    return ExpertSettings()


@pytest.fixture(scope="session")
def expert(scene, settings):
    return make_expert(scene, settings)


@pytest.fixture(scope="session")
def under(expert):
    return expert.solve(PAPER_START)

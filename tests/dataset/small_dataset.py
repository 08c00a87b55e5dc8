"""A dataset of ten trajectories, for the tests of this folder."""

import functools

from agile_jax.dataset import DatasetSettings, make_labels
from agile_jax.dataset.shard import LabelSettings
from agile_jax.engine import open_engine
from agile_jax.expert import ExpertSettings
from agile_jax.scene import SceneSettings

TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.5, 1.0], "underside": 0.25}
SCENE = SceneSettings(obstacles=[TABLE])
EXPERT = ExpertSettings(nodes=40)
DATASET = DatasetSettings(trajectories=10, shard_size=3, starts="wide")
SEED = 5
INLINE = functools.partial(open_engine, "inline")


def make(directory, engine=INLINE, expert=EXPERT, dataset=DATASET, **kwargs):
    return make_labels(LabelSettings(SCENE, expert, dataset, SEED), directory, engine, **kwargs)

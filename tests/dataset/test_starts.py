"""Where labels start: pure functions of (seed, index), and the places that "wide" must cover."""

from statistics import NormalDist

import numpy as np
import pytest

from agile_jax.dataset import DatasetSettings, rejected_shares
from agile_jax.dataset.starts import draw_start
from agile_jax.expert import ExpertSettings, planning_margin
from agile_jax.scene import SceneSettings, clearance, make_scene
from agile_jax.settings import BadInput

TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.5, 1.0], "underside": 0.25}
EXPERT = ExpertSettings()
SETTINGS = SceneSettings(obstacles=[TABLE])


@pytest.fixture(scope="module")
def scene():
    return make_scene(SETTINGS)


@pytest.mark.parametrize("starts", ["paper", "wide"])
def test_free_counted_and_reproducible(scene, starts):
    settings = DatasetSettings(starts=starts)
    drawn = [draw_start(scene, SETTINGS, EXPERT, settings, 1, i) for i in range(100)]
    poses = np.concatenate([d.poses for d in drawn])
    assert poses.shape == (100, 4)
    assert (clearance(scene, poses) >= planning_margin(EXPERT)).all()
    assert ((poses >= scene.lower) & (poses <= scene.upper)).all()
    for d in drawn:
        assert d.attempted == 1 + d.rejected_collision + d.rejected_bounds
    assert sum(d.rejected_collision for d in drawn) > 0
    np.testing.assert_array_equal(draw_start(scene, SETTINGS, EXPERT, settings, 1, 37).poses, poses[37:38])
    assert len(np.unique(poses, axis=0)) == 100
    assert (draw_start(scene, SETTINGS, EXPERT, settings, 2, 37).poses != poses[37:38]).any()


def test_wide_covers_all_sides_of_the_table_and_beyond_the_target(scene):
    settings = DatasetSettings(starts="wide")
    poses = np.concatenate([draw_start(scene, SETTINGS, EXPERT, settings, 0, i).poses for i in range(600)])
    x, y, z, yaw = poses.T
    over = (np.abs(x - 1.5) < 0.25 + scene.torso_half_size[0]) & (np.abs(y) < 0.5 + scene.torso_half_size[1])
    assert over.mean() > 0.05
    assert (z[over] < 0.17).all()
    beside = np.abs(x - 1.5) < 0.25
    for place in (
        x < 0,
        (x > 0.5) & (x < 1.0),
        beside & (y > 0.7),
        beside & (y < -0.7),
        (x > 2.2) & (x < 2.8),
        x > 3.2,
    ):
        assert place.mean() > 0.015
    assert (z < 0.2).mean() > 0.2
    assert yaw.std() == pytest.approx(settings.wide_yaw_std, rel=0.15)


def test_hopeless_starts_are_refused():
    settings = SceneSettings(
        obstacles=[{"kind": "box", "position": [0.0, 0.0, 0.25], "size": [20.0, 20.0, 0.1]}],
        target=[3.0, 0.0, 0.36, 0.0],
        lower=(-1.5, -3.0, 0.14, -3.2),
        upper=(4.5, 3.0, 0.361, 3.2),
    )
    with pytest.raises(BadInput, match="free"):
        draw_start(make_scene(settings), settings, EXPERT, DatasetSettings(starts="wide"), 0, 0)


def test_rejected_shares_are_those_of_the_normal_distribution():
    """A wall across the way, far wider than the starts: what is nearer to it than the margin is a tail."""
    wall = {"kind": "box", "position": [1.5, 0.0, 0.5], "size": [1.0, 40.0, 1.0]}
    scene = SceneSettings(obstacles=[wall], lower=(-50.0, -50.0, 0.1, -0.5), upper=(50.0, 50.0, 0.3, 0.5))
    start, (_, _, low, _), (_, _, high, _) = scene.start, scene.lower, scene.upper
    x = NormalDist(start.mean[0], start.std[0])
    z = NormalDist(start.mean[2], start.std[2])
    inside = z.cdf(high) - z.cdf(low)
    shares = rejected_shares(scene, EXPERT, (0, 7))
    reach = scene.torso_half_size[0] + planning_margin(EXPERT)
    behind = x.cdf(2.0 + reach) - x.cdf(1.0 - reach)
    assert shares["rejected_starts_bounds_share"] == pytest.approx(1 - inside, abs=2e-3)
    assert shares["rejected_starts_collision_share"] == pytest.approx(inside * behind, abs=5e-3)


def test_an_eighth_of_the_papers_starts_is_rejected():
    shares = rejected_shares(SETTINGS, EXPERT, (0, 7))
    assert shares["rejected_starts_collision_share"] == pytest.approx(0.129, abs=2e-3)
    assert shares["rejected_starts_bounds_share"] == pytest.approx(0.001, abs=5e-4)

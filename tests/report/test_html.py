"""The report stands alone, escapes what it shows, survives missing and damaged parts, and is repeatable."""

import html.parser
import json
import pathlib

import numpy as np
import pytest
from known_run import known_experiment

from agile_jax.experiment import Experiment
from agile_jax.files import sha256
from agile_jax.report import ReportSettings, mark_outdated, rendering_notes, write_report
from agile_jax.report.reading import choose_episode, load_episodes, load_outcomes
from agile_jax.scene import SceneSettings
from agile_jax.scene.tolerance import HEIGHT_TOLERANCE, PLANAR_TOLERANCE, YAW_TOLERANCE
from agile_jax.simulation.outcome import STAY

VOID = {"meta", "img", "br", "link", "input", "hr", "source"}
HOSTILE = '<script>alert("x")</script>'


class Page(html.parser.HTMLParser):
    """Collects tags, addresses and text, and refuses tags that do not match."""

    def __init__(self, content: str):
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.anchors: set[str] = set()
        self.words: list[str] = []
        self.feed(content)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for key, value in attrs if key in ("src", "href", "poster", "action", "data")]
        self.anchors |= {value for key, value in attrs if key == "id"}
        assert not [key for key, _ in attrs if key.startswith("on")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.words)


@pytest.fixture
def inputs(scene_settings) -> Experiment:
    return known_experiment(scene_settings)


def changed(inputs: Experiment, **settings: object) -> Experiment:
    return inputs.model_copy(update=settings)


def without_video(inputs: Experiment) -> Experiment:
    return changed(inputs, report=ReportSettings(renderer="drawing", video=False, width=320, height=180))


def test_a_whole_run(run_dir, inputs):
    notes = []
    path = write_report(inputs, run_dir, progress=lambda work, done, total, note="": notes.append((done, total)))
    assert path == run_dir / "report.html"
    page = Page(path.read_text())
    assert page.tags.count("video") == 1
    assert page.tags.count("img") >= 5
    assert "script" not in page.tags
    for address in page.addresses:
        assert address.startswith(("data:image/png;base64,", "data:video/mp4;base64,", "#")), address[:60]
    for address in (a for a in page.addresses if a.startswith("#")):
        assert address[1:] in page.anchors
    for words in (
        "93.8 %",
        "85.0 % to 97.5 %",
        "collision",
        "infeasible: 3",
        "under: 390",
        "0.0123",
        "0.10.2",
        "0.005",
    ):
        assert words in page.text, words
    assert "Episode 2 (success)" in page.text  # the first success that went under the table
    expected = {"paths", "learning_curve", "outcomes_mujoco", "episode_mujoco", "snapshots_mujoco"}
    assert {file.stem for file in (run_dir / "figures").glob("*.png")} == expected
    assert (run_dir / "videos/mujoco.mp4").stat().st_size > 10_000
    assert notes[-1][0] == notes[-1][1]
    assert rendering_notes(run_dir) == []  # a drawing that was asked for needs nothing

    first = path.read_bytes()
    assert write_report(inputs, run_dir).read_bytes() == first


def test_what_success_is_stands_in_the_report_with_the_numbers_that_decide_it(run_dir, inputs):
    page = Page(write_report(without_video(inputs), run_dir).read_text())
    for words in (
        f"within {PLANAR_TOLERANCE:.2f} m of the target in the plane, {HEIGHT_TOLERANCE:.2f} m in height",
        f"{YAW_TOLERANCE:g} rad in yaw",
        f"for {STAY:g} s",
        "2 T + 3 s",
        "60 degrees",
        "a slab, as in the paper: it blocks everything from 0.25 m to 0.75 m above the floor, and has no legs",
    ):
        assert words in page.text, words
    assert "distance of the torso's envelope from the nearest obstacle at the start" not in page.text  # not told here
    summary = json.loads((run_dir / "evaluation/mujoco.json").read_text())
    summary["outcomes_by_region"] = {"0.3 m and farther": {"success": 60}}
    (run_dir / "evaluation/mujoco.json").write_text(json.dumps(summary))
    page = Page(write_report(without_video(inputs), run_dir).read_text())
    assert "distance of the torso's envelope from the nearest obstacle at the start" in page.text


def test_the_headline_compares_arrivals_at_the_same_tolerance(run_dir, inputs):
    """0.9 of the duration of the whole path is no 0.9 of the expert's time of arrival."""
    summary = json.loads((run_dir / "evaluation/mujoco.json").read_text())
    summary |= {"arrival_time_ratio_median": 0.896, "arrival_time_ratio_same_tolerance_median": 1.005}
    (run_dir / "evaluation/mujoco.json").write_text(json.dumps(summary))
    content = write_report(without_video(inputs), run_dir).read_text()
    assert "<b>1.005</b><span>arrival time over the expert&#x27;s, mujoco, median</span>" in content
    assert "<b>0.896</b>" not in content
    assert "arrival time over the duration of the expert&#x27;s whole path, median</td><td>0.896" in content


def test_a_report_older_than_what_it_tells_of_is_marked(run_dir, inputs):
    path = write_report(without_video(inputs), run_dir)
    fresh = path.read_bytes()
    assert mark_outdated(run_dir) == []
    assert path.read_bytes() == fresh
    evaluation = run_dir / "evaluation/mujoco.json"
    told = evaluation.read_bytes()
    evaluation.write_text(json.dumps({"episodes": 10_000}))
    (run_dir / "evaluation/mjx.json").write_text("{}")
    for _ in range(2):  # the mark is there once
        assert mark_outdated(run_dir) == ["evaluation/mjx.json", "evaluation/mujoco.json"]
        words = "out of date: since it was written, evaluation/mjx.json, evaluation/mujoco.json changed"
        assert Page(path.read_text()).text.count(words) == 1
    evaluation.write_bytes(told)  # the evaluation asked for last is the one that it tells of, again
    (run_dir / "evaluation/mjx.json").unlink()
    assert mark_outdated(run_dir) == []
    assert path.read_bytes() == fresh
    for head in (
        b"",
        b'<meta name="agile-tells-of" content="{]">',
        b"\xff",
    ):  # of a version that named nothing; damaged
        path.write_bytes(b"<!DOCTYPE html><html><head>" + head + b"</head><body>old</body></html>")
        assert len(mark_outdated(run_dir)) == 3
        assert b"out of date" in path.read_bytes()


def test_the_report_names_what_it_tells_of(run_dir, inputs):
    (run_dir / "training/stage.json").write_text(json.dumps({"key": "feedc0de" * 8}))
    summary = json.loads((run_dir / "evaluation/mujoco.json").read_text()) | {"evaluation_key": "0b57ac1e" * 8}
    (run_dir / "evaluation/mujoco.json").write_text(json.dumps(summary))
    text = Page(write_report(without_video(inputs), run_dir).read_text()).text
    assert "feedc0de" * 2 + " " in text  # cut to the letters that tell it apart
    assert "0b57ac1e" * 2 + " " in text
    for name in ("dataset/summary.json", "training/summary.json", "evaluation/mujoco.json"):
        assert name in text
        assert sha256((run_dir / name).read_bytes())[:16] in text


def test_what_rendering_lacks_is_kept_for_the_command_line(run_dir, inputs, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    small = ReportSettings(video=False, width=320, height=180)
    page = Page(write_report(changed(inputs, scene=SceneSettings(), report=small), run_dir).read_text())
    (note,) = rendering_notes(run_dir)
    assert "apt-get install" in note
    assert note in page.text


def test_hostile_words_are_escaped(run_dir, inputs):
    summary = json.loads((run_dir / "dataset/summary.json").read_text())
    summary["failed"] = {HOSTILE: 1}
    summary[HOSTILE] = HOSTILE
    (run_dir / "dataset/summary.json").write_text(json.dumps(summary))
    (run_dir / "environment.json").write_text(json.dumps({"packages": {HOSTILE: [HOSTILE]}}))
    (run_dir / "experiment.toml").write_text(f"name = '{HOSTILE}'\n")
    (run_dir / f"evaluation/{HOSTILE.replace('/', '')}.json").write_text("{}")
    path = write_report(changed(without_video(inputs), name=HOSTILE), run_dir)
    page = Page(path.read_text())
    assert "script" not in page.tags
    assert HOSTILE in page.text


def test_an_empty_run(tmp_path, inputs):
    page = Page(write_report(inputs, tmp_path).read_text())
    for words in ("no dataset", "not been trained", "not been evaluated", "no experiment.toml", "No episode"):
        assert words in page.text, words
    assert (tmp_path / "figures/paths.png").is_file()  # needs only the settings


GROUPS = (
    ("dataset/summary.json", "training/metrics.jsonl", "evaluation/mujoco-traces.npz"),
    ("training/summary.json", "environment.json", "evaluation/mujoco.npz"),
    ("experiment.toml", "evaluation/mujoco.json"),
)


@pytest.mark.parametrize("names", GROUPS, ids=lambda names: names[0])
@pytest.mark.parametrize("damage", ["missing", "garbage", "cut"])
def test_missing_and_damaged_parts_are_survived_and_named(run_dir, inputs, names, damage):
    for name in names:
        path = run_dir / name
        if damage == "missing":
            path.unlink()
        elif damage == "garbage":
            path.write_bytes(b"\x00\xff[garbage\n" * 40)
        else:
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    no_table = changed(without_video(inputs), scene=SceneSettings())  # its path is quickly planned
    page = Page(write_report(no_table, run_dir).read_text())
    if damage == "garbage":
        for name in names:
            assert name.split("/")[-1] in page.text
    assert str(run_dir) not in page.text


def test_an_object_array_is_not_unpickled(run_dir, inputs):
    class Bomb:
        def __reduce__(self):
            return (pathlib.Path.touch, (run_dir / "exploded",))

    np.savez(run_dir / "evaluation/mujoco.npz", start=np.array([Bomb()], dtype=object), outcome=np.zeros(1))
    page = Page(write_report(without_video(inputs), run_dir).read_text())
    assert not (run_dir / "exploded").exists()
    assert "mujoco.npz: unreadable" in page.text


def test_the_episode_that_is_shown_went_under(run_dir, scene):
    outcomes = load_outcomes(run_dir / "evaluation/mujoco.npz")
    episodes = load_episodes(run_dir / "evaluation/mujoco-traces.npz", outcomes)
    assert [episode.outcome for episode in episodes] == ["collision", "success", "success"]
    chosen = choose_episode(scene, episodes)
    assert chosen is not None
    assert chosen.row == 2
    assert choose_episode(scene, episodes[:2]).row == 1  # a success before one that failed
    assert choose_episode(scene, episodes[:1]).row == 0
    assert choose_episode(scene, []) is None

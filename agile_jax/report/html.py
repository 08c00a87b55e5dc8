"""The report of a run directory: one HTML file that stands alone, beside the figures and videos it shows."""

import pathlib
from collections.abc import Callable, Mapping

from agile_jax.experiment import Experiment
from agile_jax.files import read_json, write_atomic
from agile_jax.progress import Progress, silent
from agile_jax.report import run_figures, sections
from agile_jax.report.json_files import Summary
from agile_jax.report.outdated import meta, summaries
from agile_jax.report.page import Section, page, paragraph
from agile_jax.report.video.rendering_record import write_record
from agile_jax.settings import BadInput

SUBTITLE = "From optimal control to a robot that walks and crawls to its target: what this run did, and how well."


def write_report(experiment: Experiment, run_dir: pathlib.Path, progress: Progress = silent) -> pathlib.Path:
    """Write `report.html`, `figures/*.png` and `videos/*.mp4` of a run.

    What the run does not hold yet is left out with a sentence. `rendering_notes(run_dir)` tells what
    to install for better pictures.

    Args:
        experiment: the run's settings.
        run_dir: as the pipeline leaves it (docs/architecture.md); any stage may be missing.
        progress: is told of what comes next.

    Returns:
        The path of the HTML file.

    Raises:
        OSError: the folder cannot be written.
    """
    told = summaries(run_dir)
    found = {name: read_json(run_dir / name) for name in told}
    problems = [f"{name}: not a JSON object" for name, summary in found.items() if summary is None]
    dataset, training = found.pop("dataset/summary.json", None), found.pop("training/summary.json", None)
    evaluations = {pathlib.Path(name).stem: summary or {} for name, summary in found.items()}
    total = 3 + len(evaluations)

    progress("page", 0, total, "planned paths")
    plan = _guarded(run_dir, lambda: run_figures.paths(run_dir, experiment))
    progress("page", 1, total, "learned field")
    learning = _learning(experiment, run_dir, training)
    results, pictures = _evaluations(experiment, run_dir, evaluations, progress)
    progress("page", total - 1, total, "text")

    overview = sections.overview(dataset, training, evaluations, experiment.scene)
    overview += "".join(paragraph(problem) for problem in problems)
    environment = _guarded(run_dir, lambda: sections.sources(run_dir) + sections.environment_table(run_dir))
    parts = [
        Section("overview", "Overview", overview),
        Section("video", "The robot", pictures or paragraph("No episode has been recorded yet.")),
        Section("paths", "Planned paths", plan),
        *(results or [Section("evaluation", "Evaluation", paragraph("The policy has not been evaluated yet."))]),
        Section("policy", "Policy", learning),
        Section("dataset", "Dataset", sections.dataset_table(dataset)),
        sections.settings_section(run_dir),
        Section("environment", "Environment", environment),
    ]
    path = run_dir / "report.html"
    write_atomic(path, page(experiment.name, SUBTITLE, parts, meta(told)).encode())
    progress("page", total, total)
    return path


def _learning(experiment: Experiment, run_dir: pathlib.Path, training: Summary | None) -> str:
    floor = (training or {}).get("noise_floor_mse")
    known = floor if isinstance(floor, float) else None
    makers: list[Callable[[], str]] = [
        lambda: sections.training_table(training, experiment.policy.kind),
        lambda: run_figures.learning_curve(run_dir, experiment, known),
        lambda: run_figures.velocity_field(run_dir, experiment),
        lambda: run_figures.kinematic_test(run_dir, experiment),
    ]
    return "".join(_guarded(run_dir, make) for make in makers)


def _evaluations(
    experiment: Experiment, run_dir: pathlib.Path, summaries: Mapping[str, Summary], progress: Progress
) -> tuple[list[Section], str]:
    """A section for each backend; video and snapshots of all."""
    results, pictures, records = [], "", {}
    for number, (backend, summary) in enumerate(summaries.items()):
        progress("page", 2 + number, 3 + len(summaries), f"episodes of {backend}")
        body = sections.evaluation_table(summary)
        try:
            shown, moving, rendered = run_figures.evaluation(run_dir, experiment, backend)
        except BadInput as error:
            shown, moving, rendered = _left_out(run_dir, error), "", None
        if rendered:
            records[backend] = rendered
        pictures += moving
        results.append(Section(f"evaluation-{backend}", f"Evaluation: {backend}", body + shown))
    write_record(run_dir, records)
    return results, pictures


def _guarded(run_dir: pathlib.Path, make: Callable[[], str]) -> str:
    """What `make` returns; the reason where its files cannot be used."""
    try:
        return make()
    except BadInput as error:
        return _left_out(run_dir, error)


def _left_out(run_dir: pathlib.Path, error: BadInput) -> str:
    return paragraph(f"Left out: {str(error).replace(f'{run_dir}/', '')}")

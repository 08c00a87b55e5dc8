"""The commands: each parses its arguments, calls one library function, prints, and returns the exit code."""

import json
import math
import pathlib
import sys

import agile_jax as aj
from agile_jax import benchmark as benchmarks, pipeline
from agile_jax.cli.arguments import EITHER, parse_experiment, parse_run_dir
from agile_jax.cli.exit_codes import DONE, FAILED
from agile_jax.cli.overview import LAST_STAGE
from agile_jax.cli.results import number, print_wrapped, result_lines
from agile_jax.engine import check_engine
from agile_jax.files import check_folder, write_json
from agile_jax.interruption import interruptible_progress
from agile_jax.settings import BadInput, Count, Pose, Settings


class WorkOptions(Settings):
    """How to work; nothing here changes a result."""

    run_dir: pathlib.Path | None = None
    """Where to write; the RUN_DIR that is named, or runs/NAME."""
    workers: Count | None = None
    """Worker processes of the local engine; one a core if not given."""
    engine: str = "local"
    """Who does the work: local, inline (this process), or tcp://HOST:PORT of a Dask scheduler."""
    dry_run: bool = False
    """Print what would be done, and do nothing."""


class RunOptions(WorkOptions):
    """How to run."""

    overwrite: bool = False
    """Move stage folders made with other settings aside, instead of refusing."""
    store: pathlib.Path | None = None
    """Folder in which run directories share labels and expert times; .store beside the run directory if not given."""


class PlanOptions(Settings):
    """From rest to rest, whatever expert.initial_velocity says of labels."""

    start: Pose
    """Pose x y z yaw [m, rad]."""
    target: Pose | None = None
    """Pose x y z yaw [m, rad]; the scene's if not given."""
    output: pathlib.Path | None = pathlib.Path("plan.png")
    """The drawing; None draws nothing."""


class RolloutOptions(Settings):
    """Give either --start or --replay."""

    start: Pose | None = None
    """Pose x y z yaw [m, rad]."""
    replay: pathlib.Path | None = None
    """Show this recording instead, for example RUN_DIR/evaluation/mujoco-unstable/episode-000012.npz."""
    video: pathlib.Path | None = None
    """Film it, for example out.mp4."""


class ExportOptions(Settings):
    """See docs/export.md."""

    output: pathlib.Path | None = None
    """The folder; RUN_DIR/export if not given."""


def run_stages(command: str, argv: list[str]) -> int:
    """`agile run`, `expert`, `train`, `evaluate`, `report`: the stages up to the one that the command makes."""
    experiment, options, named = parse_experiment(command, RunOptions, argv, takes=EITHER)
    check_engine(options.engine, options.workers)
    run_dir = options.run_dir or named or pathlib.Path("runs") / experiment.name
    check_folder(run_dir)
    stages = pipeline.stages_for(experiment, [LAST_STAGE[command]])
    if options.dry_run:
        if not options.overwrite:
            pipeline.refuse_other_settings(run_dir, experiment, stages)
        print(f"{experiment.name} in {run_dir}:")
        for stage, intent in pipeline.forecast(experiment, run_dir, stages).items():
            print(f"  {stage:<12}{intent}")
        return DONE
    with interruptible_progress() as progress:
        results = pipeline.run(
            experiment,
            run_dir,
            stages,
            engine=options.engine,
            workers=options.workers,
            overwrite=options.overwrite,
            store=options.store or "beside",
            progress=progress,
        )
    for line in result_lines(results):
        print_wrapped(line)
    if "report" in results:
        for note in aj.report.rendering_notes(run_dir):
            print(note, file=sys.stderr)
    found = pipeline.failures(results)
    for failure in found:
        print(failure, file=sys.stderr)
    return FAILED if found else DONE


def sweep(argv: list[str]) -> int:
    """`agile sweep`: the grid of the file's [sweep.space]."""
    experiment, options, _ = parse_experiment("sweep", WorkOptions, argv)
    check_engine(options.engine, options.workers)
    sweep_dir = options.run_dir or pathlib.Path("runs") / experiment.name
    check_folder(sweep_dir)
    if options.dry_run:
        print(aj.sweep.table(experiment, aj.sweep.list_trials(experiment, sweep_dir)))
        return DONE
    with interruptible_progress() as progress:
        trials = aj.sweep.run_sweep(
            experiment, sweep_dir, engine=options.engine, workers=options.workers, progress=progress
        )
    print(aj.sweep.table(experiment, trials))
    print(f"results: {sweep_dir / 'sweep.json'}")
    return FAILED if any(trial.status == "failed" for trial in trials) else DONE


def study(argv: list[str]) -> int:
    """`agile study`: the values of the file's [study]."""
    experiment, options, named = parse_experiment("study", WorkOptions, argv, takes=EITHER)
    check_engine(options.engine, options.workers)
    settings = aj.study.study_settings(experiment)
    study_dir = options.run_dir or named or pathlib.Path("runs") / experiment.name
    check_folder(study_dir)
    if options.dry_run:
        rows = aj.study.make_rows(settings, aj.study.list_values(experiment, study_dir))
        print(aj.study.table(settings, rows))
        return DONE
    with interruptible_progress() as progress:
        rows = aj.study.run_study(
            experiment, study_dir, engine=options.engine, workers=options.workers, progress=progress
        )
    print(aj.study.table(settings, rows))
    for sentence in aj.study.sentences(settings, rows):
        print_wrapped(sentence)
    print(f"results: {study_dir / 'study.html'}")
    return FAILED if any(row["status"] == "failed" for row in rows) else DONE


def status(argv: list[str]) -> int:
    """`agile status`: what is done of a run, a sweep or a study, and what is left; writes nothing."""
    directory, _ = parse_run_dir("status", Settings, argv)
    path = directory / "experiment.toml"
    if not path.is_file():
        raise BadInput(f"{directory}: is no folder of a run, a sweep or a study: it has no experiment.toml")
    experiment, varies = aj.load_experiment(path), (directory / "trials").is_dir()
    if varies and experiment.study is not None:
        rows = aj.study.make_rows(experiment.study, aj.study.list_values(experiment, directory))
        print(aj.study.table(experiment.study, rows))
    elif varies:
        print(aj.sweep.table(experiment, aj.sweep.list_trials(experiment, directory)))
    else:
        for stage, intent in pipeline.forecast(experiment, directory).items():
            print(f"{stage:<12}{intent}")
    return DONE


def plan(argv: list[str]) -> int:
    """`agile plan`: one expert solve, printed and drawn."""
    experiment, options, _ = parse_experiment("plan", PlanOptions, argv)
    solution = aj.solve(experiment, options.start, options.target)
    if solution.status != "solved":
        print(f"no path from {list(options.start)}: {solution.cause}", file=sys.stderr)
        return FAILED
    if options.output is not None:
        solution.save(options.output, experiment.name)
    print(f"duration      {solution.duration:.4f} s")
    print(f"lower bound   {solution.lower_bound:.4f} s (gap {100 * solution.gap:.2f} %)")
    print(f"branch        {solution.branch}")
    if math.isfinite(solution.min_clearance):
        print(f"clearance     {solution.min_clearance:.4f} m at the least")
    print(f"passes under  {solution.lowest_underside:.3f} m at the least, as low as it can crouch with its margin")
    print(f"top speed     {solution.top_speed:.2f} m/s at {solution.lowest_height:.3f} m, the lowest of the path")
    print(f"solved in     {1000 * solution.solve_time_s:.0f} ms")
    if options.output is not None:
        print(f"drawing       {options.output}")
    return DONE


def rollout(argv: list[str]) -> int:
    """`agile rollout`: one closed-loop episode of a finished run."""
    run_dir, options = parse_run_dir("rollout", RolloutOptions, argv)
    if (options.start is None) == (options.replay is None):
        raise BadInput("rollout needs either --start X Y Z YAW or --replay FILE")
    run = aj.open_run(run_dir)
    with interruptible_progress() as progress:
        if options.replay is not None:
            episode = run.recording(options.replay)
        elif options.start is not None:
            episode = run.rollout(options.start, progress)
    result = dict(episode.summary)
    if options.video is not None:
        note = episode.video(options.video)
        result |= {"video": str(options.video)} | ({"video_note": note} if note else {})
    for key, value in result.items():
        print(f"{key:<28}{number(value)}")
    return DONE


def export(argv: list[str]) -> int:
    """`agile export`: the policy of a finished run, for use elsewhere."""
    run_dir, options = parse_run_dir("export", ExportOptions, argv)
    exported = aj.open_run(run_dir).export(options.output)
    for path in exported.paths:
        print(path)
    if exported.note:
        print(exported.note)
    return DONE


def compare(argv: list[str]) -> int:
    """`agile compare`: two evaluations from the same starts."""
    if {"-h", "--help"} & set(argv):
        print("usage: agile compare RUN_DIR[:NAME] RUN_DIR[:NAME] [mujoco|mjx]\n")
        print("Pair the episodes of two evaluations from the same starts: McNemar's exact test, arrival times.")
        print("NAME picks one of a run's evaluations: its evaluation.name, or the beginning of its key.")
        return DONE
    if not 2 <= len(argv) <= 3:
        raise BadInput("which two evaluations? usage: agile compare RUN_DIR[:NAME] RUN_DIR[:NAME] [mujoco|mjx]")

    for key, value in aj.evaluation.compare(*argv).items():
        text = "-".join(f"{end:.4g}" for end in value) if isinstance(value, list) else number(value)
        print(f"{key:<28}{text}")
    return DONE


def benchmark(argv: list[str]) -> int:
    """`agile benchmark SUBJECT`: ours against the peers."""
    name, *rest = argv or [""]
    subjects = benchmarks.SUBJECTS
    if name in ("-h", "--help"):
        print("usage: agile benchmark SUBJECT [EXPERIMENT.toml] [OPTIONS]\n")
        print("\n".join(f"{known:<12}{subject.about}" for known, subject in subjects.items()))
        return DONE
    if name not in subjects:
        raise BadInput(f"which benchmark? There are: {', '.join(subjects)}{f', not {name}' if name else ''}")
    subject = subjects[name]
    experiment, options, _ = parse_experiment(f"benchmark {name}", subject.options, rest, subject.experiment)
    with interruptible_progress() as progress:
        result = subject.measure(experiment, options, progress)
    print(getattr(benchmarks, name).report(result))
    if options.output is not None:
        write_json(options.output, result)
    return DONE


def schema(argv: list[str]) -> int:
    """`agile schema`: the JSON schema of experiment files."""
    if argv and argv[0] in ("-h", "--help"):
        print("usage: agile schema\n\nPrint the JSON schema of experiment files, for editors and other programs.")
        return DONE
    if argv:
        raise BadInput(f"schema takes no arguments, not {' '.join(argv)}")
    print(json.dumps(aj.experiment.json_schema(), indent=2))
    return DONE

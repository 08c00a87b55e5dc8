"""The commands, and the text of `agile --help`."""

COMMANDS = {  # name: (arguments, what it does)
    "run": ("EXPERIMENT.toml|RUN_DIR", "the whole pipeline: expert, training, evaluation, report"),
    "expert": ("EXPERIMENT.toml|RUN_DIR", "solve the optimal control problems: the dataset"),
    "train": ("EXPERIMENT.toml|RUN_DIR", "train the velocity field, after what it needs"),
    "evaluate": ("EXPERIMENT.toml|RUN_DIR", "closed-loop episodes of the robot, after what they need"),
    "report": ("EXPERIMENT.toml|RUN_DIR", "figures, video and report.html, after what they need"),
    "sweep": ("EXPERIMENT.toml", "every point of the file's [sweep.space]"),
    "study": ("EXPERIMENT.toml|STUDY_DIR", "success, clearance and time against one number: the file's [study]"),
    "status": ("DIR", "what is done and what is left of a run, a sweep or a study"),
    "plan": ("EXPERIMENT.toml --start X Y Z YAW", "one optimal path, printed and drawn"),
    "rollout": ("RUN_DIR --start X Y Z YAW", "one closed-loop episode of a finished run, or --replay FILE"),
    "export": ("RUN_DIR", "the trained policy of a finished run, in files for use elsewhere"),
    "compare": ("RUN_DIR RUN_DIR", "two evaluations from the same starts, paired"),
    "benchmark": ("SUBJECT [EXPERIMENT.toml]", "speed and quality against the peers"),
    "schema": ("", "the JSON schema of experiment files"),
}
LAST_STAGE = {  # by the command that makes it, after what it needs
    "expert": "dataset",
    "train": "training",
    "evaluate": "evaluation",
    "report": "report",
    "run": "report",
}


def overview() -> str:
    """The text of `agile --help`."""
    lines = [f"  agile {name + ' ' + arguments:<41}{does}" for name, (arguments, does) in COMMANDS.items()]
    return "\n".join(
        [
            "usage: agile COMMAND [ARGUMENTS] [OPTIONS]",
            "",
            "From optimal control to a robot that crawls under a table.",
            "",
            *lines,
            "",
            "`agile COMMAND --help` lists the options, `agile COMMAND EXPERIMENT.toml --help` with that file's values.",
            "Every setting of an experiment is an option, for example --training.learning-rate 0.1.",
            "Own experts, policies, controllers and obstacles: --plugin MODULE (docs/extending.md).",
            "The same command goes on where an earlier one stopped. `agile --version` prints the version.",
        ]
    )

"""The `agile` command: parses, calls one library function, prints.

Exit codes: 0 done, 1 finished with failures that are named, 2 bad input, 130 and 143 interrupted by SIGINT and SIGTERM.
"""

import os
import signal
import sys
from collections.abc import Sequence

from agile_jax.cli.environment import check_opengl, prepare_libraries, use_one_thread
from agile_jax.cli.exit_codes import BAD_INPUT, DONE, FAILED, INTERRUPTED, TERMINATED
from agile_jax.cli.overview import COMMANDS, LAST_STAGE, overview
from agile_jax.engine import TasksFailedError
from agile_jax.interruption import Interrupted
from agile_jax.settings import BadInput

__all__ = ["BAD_INPUT", "COMMANDS", "DONE", "FAILED", "main", "overview"]

DEVICE_ERRORS = ("JaxRuntimeError", "XlaRuntimeError")  # of JAX, which most commands have not loaded
SIMULATING = ("run", "evaluate", "report", "sweep", "study", "status", "rollout", "compare")  # these import mujoco


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Args:
        arguments: after the program's name; None takes them from the command line.
    """
    argv = list(sys.argv[1:] if arguments is None else arguments)
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(overview())
        return DONE if argv else BAD_INPUT
    if argv[0] == "--version":
        from importlib.metadata import version

        print(f"agile_jax {version('agile_jax')}")
        return DONE
    resume = "the same command goes on where this one stopped"
    try:
        return _dispatch(argv[0], argv[1:])
    except BadInput as error:
        return _say(str(error), BAD_INPUT)
    except BrokenPipeError:  # the reader of our output has gone (`| head`)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _say(f"{where}{error.strerror or error}; what was finished is kept, {resume}", FAILED)
    except TasksFailedError as error:
        return _say(str(error), FAILED)
    except RuntimeError as error:
        if type(error).__name__ not in DEVICE_ERRORS:
            raise
        return _say(f"the device failed: {str(error).splitlines()[0]}; what was finished is kept, {resume}", FAILED)
    except KeyboardInterrupt:
        return _say(f"interrupted; {resume}", INTERRUPTED)
    except Interrupted as error:
        if error.number == signal.SIGINT:
            return _say(f"interrupted; {resume}", INTERRUPTED)
        return _say(f"terminated; {resume}", TERMINATED)


def _dispatch(name: str, argv: list[str]) -> int:
    if name not in COMMANDS:
        import difflib

        near = difflib.get_close_matches(name, COMMANDS, 1)
        hint = f"did you mean `agile {near[0]}`? " if near else ""
        raise BadInput(f"{name}: unknown command; {hint}Commands: {', '.join(COMMANDS)}")
    if name == "benchmark":
        if argv[:1] in (["expert"], ["mpc"], ["policy"]):
            use_one_thread(argv[:1] != ["expert"])
    elif name != "schema":
        prepare_libraries()
    if name in SIMULATING:
        check_opengl()
    argv = _load_plugins(argv)
    from agile_jax.cli import commands

    code: int = commands.run_stages(name, argv) if name in LAST_STAGE else getattr(commands, name)(argv)
    return code


def _load_plugins(argv: list[str]) -> list[str]:
    """Load the plugins that `--plugin MODULE` names, as often as it stands there; returns the other arguments."""
    modules, rest, waiting = [], [], iter(argv)
    for argument in waiting:
        option, equals, value = argument.partition("=")
        if option != "--plugin":
            rest.append(argument)
        elif value or (value := "" if equals else next(waiting, "")):
            modules.append(value)
        else:
            raise BadInput("--plugin needs the name of a Python module, or the path of a .py file")
    if modules:
        from agile_jax import plugins

        plugins.load(modules)
    return rest


def _say(text: str, code: int) -> int:
    first, *rest = text.splitlines()
    print("\n".join([f"agile: {first}", *(f"  {line}" for line in rest)]), file=sys.stderr, flush=True)
    return code

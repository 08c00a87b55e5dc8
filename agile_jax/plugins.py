"""Own experts, policies, controllers and obstacles: what other packages and files add to the kinds of this one.

A plugin is a Python module that registers what it adds when it is imported:

    from agile_jax.plugins import register

    @register("expert", "straight")
    def make_straight(scene, settings): ...

An experiment names it: `expert.kind = "straight"`; with `register(..., settings=Model)` its section has the fields of
that model, a subclass of the section's own. A plugin is imported only where somebody at this machine says so: by
`--plugin MODULE`, `plugins=[...]`, an `import`, or an installed package with an entry point in the group
"agile_jax.plugins". An experiment file alone imports nothing.

A result depends on the plugins that made it: their name, version and source are part of its key (`digests`), and
worker processes load the same ones (`ship`).
"""

import difflib
import importlib
import importlib.metadata
import pathlib
import pickle
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Literal, NamedTuple, TypeVar

from pydantic import ValidatorFunctionWrapHandler

from agile_jax.files import sha256
from agile_jax.settings import BadInput, Settings

Kind = Literal["expert", "policy", "controller", "obstacle"]
Made = TypeVar("Made", bound=Callable[..., object])
Task = TypeVar("Task")

GROUP = "agile_jax.plugins"
HOW = "a plugin adds others: `--plugin MODULE`, or `plugins=[...]` in Python (docs/extending.md)"


class Plugin(NamedTuple):
    """What is registered under a name."""

    make: Callable[..., object]
    settings: type[Settings] | None  # of its section; None for the section's own
    module: str


_registered: dict[tuple[Kind, str], Plugin] = {}
_files: dict[str, str] = {}  # the file of a module that was loaded from one


def register(kind: Kind, name: str, settings: type[Settings] | None = None) -> Callable[[Made], Made]:
    """Decorate what makes an own expert, policy or controller, or the settings of an own obstacle.

    Args:
        kind: what it is; docs/extending.md says what each is called with.
        name: its `kind` in an experiment.
        settings: model of its section, if that has fields of its own: a subclass of the section's.

    Raises:
        BadInput: another module has registered the name.
    """

    def keep(make: Made) -> Made:
        known = _registered.get((kind, name))
        if known is not None and known.module != make.__module__:
            raise BadInput(f"the {kind} {name!r} of {make.__module__} is registered by {known.module} already")
        model = make if isinstance(make, type) and issubclass(make, Settings) else settings
        _registered[kind, name] = Plugin(make, model, make.__module__)
        return make

    return keep


def load(modules: Iterable[str]) -> None:
    """Import plugins: names of modules, or Python files.

    Raises:
        BadInput: there is no such module, or it fails.
    """
    for module in modules:
        name = module
        if module.endswith(".py"):
            file = pathlib.Path(module).expanduser().resolve()
            if not file.is_file():
                raise BadInput(f"plugin {module}: no such file")
            name = file.stem
            if str(file.parent) not in sys.path:
                sys.path.append(str(file.parent))
        try:
            found = importlib.import_module(name)
        except Exception as error:
            raise BadInput(f"plugin {module} cannot be imported ({type(error).__name__}: {error})") from error
        if module.endswith(".py"):
            if pathlib.Path(found.__file__ or "").resolve() != file:
                raise BadInput(f"plugin {module}: {name} is another module already, {found.__file__}; rename it")
            _files[name] = str(file)


def find(kind: Kind, name: str) -> Callable[..., object]:
    """What is registered under a name, here or by an installed package.

    Raises:
        BadInput: nothing is.
    """
    if name not in names(kind):
        raise BadInput(f"there is no {kind} {name!r}; {HOW}")
    return _registered[kind, name].make


def names(kind: Kind) -> tuple[str, ...]:
    """The registered names of a kind, those of installed packages too."""
    _load_installed()
    return tuple(name for which, name in _registered if which == kind)


def _not_one_of(name: str, known: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"must be one of {', '.join(map(repr, known))}{hint}; {HOW}"


@cache
def _load_installed() -> None:
    load(dict.fromkeys(entry.module for entry in importlib.metadata.entry_points(group=GROUP)))


def one_of(kind: Kind, *own: str) -> Callable[[str], str]:
    """A check of settings: that a name is the package's own or a plugin's.

    Raises:
        ValueError: it is neither; the message lists the names.
    """

    def check(name: str) -> str:
        if name in own or name in names(kind):
            return name
        raise ValueError(_not_one_of(name, own + names(kind)))

    return check


def by_kind(kind: Kind, *own: str) -> Callable[[object, ValidatorFunctionWrapHandler], object]:
    """A validator of a section, or of an obstacle: a table that names a plugin is read by the plugin's model.

    Args:
        kind: of what the table describes.
        own: the package's names.
    """

    def choose(value: object, handler: ValidatorFunctionWrapHandler) -> object:
        name = value.get("kind") if isinstance(value, Mapping) else None
        if not isinstance(name, str) or name in own:
            return handler(value)
        if name not in names(kind):
            if kind == "obstacle":  # a section's model checks its kind by itself, a union of models does not
                raise ValueError(f"kind = {name!r} {_not_one_of(name, own + names(kind))}")
            return handler(value)
        model = _registered[kind, name].settings
        return handler(value) if model is None else model.model_validate(value)

    return choose


@cache
def version(module: str) -> str:
    """`name==version+digest` of the package or file that a module belongs to: its own version, if it says one, and a
    hash of its Python source.

    Raises:
        BadInput: its source is nowhere, as at a Python prompt.
    """
    top = sys.modules[module.partition(".")[0]]
    file = getattr(top, "__file__", None)
    if file is None:
        raise BadInput(f"the plugin {module} has no source file by which its results could be known: write it to one")
    inside = pathlib.Path(file).parent.rglob("*.py") if file.endswith("__init__.py") else [pathlib.Path(file)]
    source = b"".join(path.read_bytes() for path in sorted(inside))
    stated = getattr(top, "__version__", None)
    for distribution in importlib.metadata.packages_distributions().get(top.__name__, []):
        stated = stated or importlib.metadata.version(distribution)
    return f"{top.__name__}=={stated or 0}+{sha256(source)[:16]}"


def digests(settings: Mapping[str, object]) -> dict[str, str]:
    """The versions of the plugins that settings name, by kind: what a key has of them (store/artefact.py).

    Args:
        settings: of an experiment, as nested tables.
    """
    scene = settings.get("scene")
    obstacles = scene.get("obstacles") if isinstance(scene, Mapping) else ()
    sections: dict[Kind, Iterable[object]] = {
        "expert": (settings.get("expert"),),
        "policy": (settings.get("policy"),),
        "controller": (settings.get("control"),),
        "obstacle": obstacles if isinstance(obstacles, list | tuple) else (),
    }
    found = {}
    for kind, tables in sections.items():
        named = [str(table.get("kind")) for table in tables if isinstance(table, Mapping)]
        modules = {_registered[kind, name].module for name in named if (kind, name) in _registered}
        if modules:
            found[str(kind)] = " ".join(sorted(map(version, modules)))
    return found


class Shipped(NamedTuple):
    """A task for a worker process that needs the plugins of this one."""

    plugins: tuple[tuple[str, str], ...]  # module or file, and its version here
    task: bytes  # function and argument, read after the plugins are there


def ship(function: Callable[[Task], object], task: Task) -> Shipped | None:
    """A task with the plugins that are loaded; None when there are none.

    Raises:
        BadInput: one stands in the main script, which no other process can import.
    """
    modules = sorted({plugin.module for plugin in _registered.values()})
    if "__main__" in modules:
        raise BadInput(
            "a plugin of the main script is not seen by worker processes: move it to a module of its own, or work "
            "without workers"
        )
    needed = tuple((_files.get(module, module), version(module)) for module in modules)
    return Shipped(needed, pickle.dumps((function, task))) if needed else None


def unpack(shipped: Shipped) -> object:
    """Load the plugins of a task and do it. Runs in a worker.

    Raises:
        BadInput: a plugin is not there, or of another version.
    """
    load(module for module, _ in shipped.plugins)
    for module, wanted in shipped.plugins:
        here = version(pathlib.Path(module).stem if module.endswith(".py") else module)
        if here != wanted:
            raise BadInput(f"plugin {module} is {here} on a worker, {wanted} here; install the same everywhere")
    function, task = pickle.loads(shipped.task)
    return function(task)

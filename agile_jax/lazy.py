"""Names of a package that load their module when first used (PEP 562).

A stage's settings must be readable without its heavy libraries: `agile schema` and the expert's workers load no JAX.
So the `__init__` of a heavy stage imports only its settings, and lists its other names here and, for the type
checker, under TYPE_CHECKING.
"""

import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any


def lazy_names(package: str, homes: dict[str, str]) -> Callable[[str], Any]:
    """The `__getattr__` of `package`.

    Args:
        package: its `__name__`.
        homes: the modules of the package, each with the public names that live there, separated by spaces.
    """
    module_of = {name: module for module, names in homes.items() for name in names.split()}

    def __getattr__(name: str) -> Any:  # noqa: N807
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{module_of[name]}"), name)
        # Importing a submodule binds it to its own name in the package; a function of that name must win.
        setattr(sys.modules[package], name, value)
        return value

    return __getattr__

"""Names of a package that load their module when first used (PEP 562).

A stage's settings must be readable without its heavy libraries: `agile schema` and the expert's workers load no JAX.
So the `__init__` of a heavy stage imports only its settings, and lists its other names here and, for the type
checker, under TYPE_CHECKING.
"""

import sys
from collections.abc import Callable
from importlib import import_module


def lazy_names(package: str, homes: dict[str, str], subpackages: str = "") -> Callable[[str], object]:
    """The `__getattr__` of `package`; its `__dir__`, for tab completion, is set here, too.

    Args:
        package: its `__name__`.
        homes: the modules of the package, each with the public names that live there, separated by spaces.
        subpackages: names that are modules themselves, separated by spaces.
    """
    module_of = {name: module for module, names in homes.items() for name in names.split()}
    modules = subpackages.split()

    def __getattr__(name: str) -> object:  # noqa: N807
        if name in modules:
            return import_module(f"{package}.{name}")
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value: object = getattr(import_module(f"{package}.{module_of[name]}"), name)
        # Importing a submodule binds it to its own name in the package; a function of that name must win.
        setattr(sys.modules[package], name, value)
        return value

    def __dir__() -> list[str]:  # noqa: N807
        known = vars(sys.modules[package])
        return sorted({*known.get("__all__", known), *module_of, *modules})

    vars(sys.modules[package])["__dir__"] = __dir__
    return __getattr__

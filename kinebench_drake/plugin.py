"""Code that is loaded by name: the benchmark, and classes named `module:Class` or `FILE.py:Class` by the user."""

import importlib
import importlib.util
import os
import re
import sys
from pathlib import Path
from types import ModuleType

from kinebench_drake.errors import UsageError

BENCHMARK = "kinebench_drake.suites.entry"
"""Module of the benchmark (`runs.benchmark_registry`); nothing outside `suites` imports it."""
_CLASS = re.compile(r"([A-Za-z_][\w.]*|.+\.py):[A-Za-z_]\w*")


def is_class_name(text: str) -> bool:
    """Return whether `text` has the form `module:Class` or `FILE.py:Class`."""
    return _CLASS.fullmatch(text) is not None


def load_class(spec: str, *, argument: str, method: str, arguments: str) -> type:
    """Import the class of a spec: `module:Class`, installed or in the working directory, or `FILE.py:Class`.

    It must have `method`. `argument`, which holds the spec, and the method's `arguments` are for messages.

    Raises:
        UsageError: there is no such module or class, or the class has no such method.
    """
    module_name, _, name = spec.rpartition(":")
    if os.getcwd() not in sys.path and "" not in sys.path:
        sys.path.append(os.getcwd())  # not removed: the class may import modules beside it later
    try:
        is_file = module_name.endswith(".py")
        loaded = getattr(_load_file(Path(module_name)) if is_file else importlib.import_module(module_name), name)
    except ModuleNotFoundError as error:
        raise UsageError(
            f"${argument} {spec}: there is no module {error.name!r}; expected one that is installed, or a file "
            f"{(error.name or module_name).split('.')[0]}.py in the working directory"
        ) from None
    except AttributeError:
        raise UsageError(f"${argument} {spec}: the module {module_name} has no {name}") from None
    except Exception as error:  # code of the user, which may raise anything
        raise UsageError(f"${argument} {spec}: cannot be imported ({type(error).__name__}: {error})") from error
    if not isinstance(loaded, type) or not callable(getattr(loaded, method, None)):
        raise UsageError(f"${argument} {spec}: expected a class with a method {method}({arguments})")
    return loaded


def _load_file(path: Path) -> ModuleType:
    """Execute a Python file as a module of its own name, which replaces an earlier one of the same file."""
    name = f"plugin_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module

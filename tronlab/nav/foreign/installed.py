"""From ``package.module:attribute`` or an installed core's name to what makes the core."""

import importlib
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias, cast

from tronlab.errors import ScoreError
from tronlab.nav.core import CoreContext, NavigationCore
from tronlab.nav.installed import installed_core

Factory: TypeAlias = Callable[[CoreContext], NavigationCore]


@dataclass(frozen=True, slots=True)
class HostedCore:
    """A class or factory, and the module that names it, which need not be the one that has it."""

    name: str
    """As the user wrote it."""
    factory: Factory
    module: str


def load_core(text: str) -> HostedCore:
    """Import a class or factory.

    Raises:
        ScoreError: It cannot be imported, or cannot be called; or no core of that name is
            installed.
    """
    # An entry point may name extras, in brackets.
    named = text if ":" in text else installed_core(text).value.partition("[")[0].strip()
    module, _, attribute = named.partition(":")
    try:
        found: Any = importlib.import_module(module)
        for name in attribute.split("."):
            found = getattr(found, name)
    except Exception as error:  # a module may raise anything while it is imported
        traceback.print_exc()
        raise ScoreError(f"{text} cannot be imported: {type(error).__name__}: {error}") from error
    if not callable(found):
        raise ScoreError(f"{text} is a {type(found).__name__}, must be a class or a factory")
    return HostedCore(text, cast(Factory, found), module)

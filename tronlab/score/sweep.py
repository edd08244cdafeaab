"""The sweep file: navigation cores, and the settings that each of them is tried with."""

import itertools
import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import Field, JsonValue

from tronlab.errors import ConfigError, ScoreError
from tronlab.nav.cores import is_built_in
from tronlab.nav.settings import Count, FeatureCoreSettings, Positive
from tronlab.nav.specs import CoreSpec, parse_core
from tronlab.score.rescoring.prior import PriorSettings
from tronlab.yaml_models import (
    ExistingFile,
    Location,
    Model,
    dotted,
    join_errors,
    line_of,
    parse_mapping,
    parse_model,
    read_text,
)

Value: TypeAlias = bool | int | float | str | None
Seed: TypeAlias = Annotated[int, Field(ge=0)]

_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9._:@+-]")
_DATABASE = "database"


class SweptCore(Model):
    """One core and what is tried with it."""

    core: str | None = None
    """Where the core is, as ``tronlab score --core`` takes it; without it the name says so."""
    settings: dict[str, JsonValue] = Field(default_factory=dict[str, JsonValue])
    """What all its variants have in common. Those of built-in cores are listed below; cores of
    others get theirs as they stand here."""
    sweep: dict[str, tuple[Value, ...]] = Field(default_factory=dict[str, tuple[Value, ...]])
    """Settings, as ``section.key``, each with the values to try: every combination is a variant."""


class Sweep(Model):
    """What a sweep file says."""

    cores: Annotated[dict[str, SweptCore | None], Field(min_length=1)]
    """Name in the table of scores to core. A variant is called ``name@key=value,key=value``."""
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)] = (0,)
    """Every variant is scored once with each of them."""
    prior: PriorSettings | None = None
    """What cores are told of a pose before they look; without it nothing."""
    time_limit_s: Positive | None = None
    """A core that takes longer over an image has not answered."""
    database: ExistingFile | None = None
    """File of ``tronlab database build`` for all built-in cores that name no other."""
    max_variants: Count = 1000
    """A sweep of more is refused: it is more often a slip than a wish."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One combination of a core's settings."""

    spec: CoreSpec
    """With the seed 0."""
    core: str
    """Name of the core that it is a variant of."""
    values: Mapping[str, Value]
    """What is swept, by dotted key."""

    @property
    def name(self) -> str:
        """Get the name the scores carry."""
        return self.spec.name


@dataclass(frozen=True, slots=True)
class SweepPlan:
    """A sweep file, ready to be scored."""

    variants: tuple[Variant, ...]
    seeds: tuple[int, ...]
    prior: PriorSettings | None
    time_limit_s: float | None

    @property
    def keys(self) -> tuple[str, ...]:
        """Get every dotted key that is swept, in the order of the file."""
        return tuple(dict.fromkeys(key for variant in self.variants for key in variant.values))


def load_sweep(path: Path, *, database: Path | None = None) -> SweepPlan:
    """Read a sweep file.

    Args:
        path: The file.
        database: Of all built-in cores that name no other, in place of the file's.

    Raises:
        ConfigError: The file cannot be read, or does not fit the model, or a built-in core has no
            such setting; one line a problem, each with file, line, key and what is allowed.
    """
    text = read_text(path)
    sweep = parse_model(text, Sweep, path=path)
    problems = [
        ConfigError(problem, path=path, line=line_of(text, where), key=dotted(where))
        for where, problem in _problems(sweep, path.parent)
    ]
    if problems:
        raise join_errors(sorted(problems, key=lambda problem: problem.line or 0))
    variants = tuple(_variants(sweep, path.parent, database or sweep.database))
    twice = _first_twice([variant.name for variant in variants])
    if twice is not None:
        raise ConfigError(
            f"two variants are called {twice}; values that differ only in signs a name cannot"
            " have need another writing, or a core another name",
            path=path,
            line=line_of(text, ("cores",)),
            key="cores",
        )
    return SweepPlan(variants, sweep.seeds, sweep.prior, sweep.time_limit_s)


def with_seeds(specs: Sequence[CoreSpec], seeds: Sequence[int]) -> tuple[CoreSpec, ...]:
    """Give each core once with each seed."""
    return tuple(replace(spec, seed=seed) for spec in specs for seed in seeds)


def with_database(spec: CoreSpec, database: Path | None) -> CoreSpec:
    """Give a core its database, if it is one of ours and names no other."""
    if database is None or not is_built_in(spec) or spec.settings.get(_DATABASE) is not None:
        return spec
    return replace(spec, settings={**spec.settings, _DATABASE: str(database.resolve())})


def _problems(sweep: Sweep, folder: Path) -> Iterator[tuple[Location, str]]:
    """Find what the model alone cannot see; give where it stands and what it is."""
    n_variants = sum(_n_variants(swept) for swept in sweep.cores.values())
    if n_variants > sweep.max_variants:
        yield (
            ("cores",),
            f"{n_variants} variants are more than max_variants allows, {sweep.max_variants};"
            " try fewer values, or raise max_variants",
        )
        return
    if (twice := _first_twice(sweep.seeds)) is not None:
        yield ("seeds",), f"{twice} stands twice"
    for name, swept in sweep.cores.items():
        for where, problem in _problems_of_core(name, swept or _NOTHING_SWEPT, folder):
            yield ("cores", name, *where), problem


def _problems_of_core(name: str, swept: SweptCore, folder: Path) -> Iterator[tuple[Location, str]]:
    try:
        spec = _spec(name, swept)
    except ScoreError as error:
        yield (("core",) if swept.core else ()), str(error)
        return
    yield from _contradictions(swept)
    if is_built_in(spec):
        yield from _wrong_settings(swept, folder)


def _contradictions(swept: SweptCore) -> Iterator[tuple[Location, str]]:
    for key, values in swept.sweep.items():
        if not all(key.split(".")):
            yield ("sweep", key), "not a key; write section.key"
            continue
        if not values:
            yield ("sweep", key), "no values to try; write [VALUE, VALUE]"
        if (twice := _first_twice([json.dumps(value) for value in values])) is not None:
            yield ("sweep", key), f"{twice} stands twice"
        if any(other.startswith(f"{key}.") for other in swept.sweep):
            yield ("sweep", key), "is swept, and so is a part of it; remove one of them"
        if _stands_in(swept.settings, key):
            yield ("sweep", key), "stands in settings, too; remove it from one of them"


def _stands_in(settings: Mapping[str, Any], key: str) -> bool:
    """Tell whether settings say something about a dotted key, or a value where it has a section."""
    node: Any = settings
    for part in key.split("."):
        if not isinstance(node, Mapping):
            return True
        if part not in node:
            return False
        node = node[part]
    return True


def _wrong_settings(swept: SweptCore, folder: Path) -> Iterator[tuple[Location, str]]:
    for where, problem in _unfit(swept.settings, folder):
        yield ("settings", *where), problem
    for key, values in swept.sweep.items():
        told: set[str] = set()
        for i, value in enumerate(values):
            for _, problem in _unfit(_nested(key, value), folder):
                # A key that does not exist does not exist for any of the values.
                if problem not in told:
                    yield ("sweep", key, i), problem
                told.add(problem)


def _unfit(settings: Mapping[str, Any], folder: Path) -> Iterator[tuple[Location, str]]:
    """Find what the built-in cores do not know of some settings."""
    try:
        parse_mapping(settings, FeatureCoreSettings, key="settings")
    except ConfigError as error:
        for part in error.parts:
            key = part.key or ""
            yield tuple(key.split(".")[1:]), str(part).removeprefix(f"{key}: ")
        return
    database = settings.get(_DATABASE)
    if database is not None and not (folder / Path(database).expanduser()).is_file():
        yield (_DATABASE,), f"no such file: {folder / Path(database).expanduser()}"


def _variants(sweep: Sweep, folder: Path, database: Path | None) -> Iterator[Variant]:
    keys = [key for swept in sweep.cores.values() if swept for key in swept.sweep]
    short = _short_keys(keys)
    for name, given in sweep.cores.items():
        swept = given or _NOTHING_SWEPT
        base = _spec(name, swept)
        for combination in itertools.product(*swept.sweep.values()):
            values = dict(zip(swept.sweep, combination, strict=True))
            tried = ",".join(f"{short[key]}={_as_text(value)}" for key, value in values.items())
            settings = _with_values(swept.settings, values)
            if is_built_in(base) and settings.get(_DATABASE) is not None:
                settings[_DATABASE] = str(_beside(folder, settings[_DATABASE]))
            spec = replace(base, name=f"{base.name}@{tried}" if tried else base.name)
            spec = with_database(replace(spec, settings=settings), database)
            yield Variant(spec, base.name, values)


def _beside(folder: Path, path: str) -> Path:
    """Resolve a file that is named relative to the sweep file."""
    return (folder / Path(path).expanduser()).resolve()


def _spec(name: str, swept: SweptCore) -> CoreSpec:
    """Read which core is meant.

    Raises:
        ScoreError: It is not written as a core is, or its name cannot be one.
    """
    return parse_core(f"{name}={swept.core}" if swept.core else name)


def _n_variants(swept: SweptCore | None) -> int:
    n = 1
    for values in (swept or _NOTHING_SWEPT).sweep.values():
        n *= len(values)
    return n


def _short_keys(keys: Sequence[str]) -> dict[str, str]:
    """Give each dotted key its last part, or all of it where two of them end alike."""
    n_ending_so = Counter(_last_part(key) for key in set(keys))
    chosen = {key: _last_part(key) if n_ending_so[_last_part(key)] == 1 else key for key in keys}
    return {key: _NOT_IN_NAMES.sub("_", text) for key, text in chosen.items()}


def _last_part(key: str) -> str:
    return key.rpartition(".")[2]


def _as_text(value: Value) -> str:
    """Write a value so that it can stand in a name."""
    text = value if isinstance(value, str) else json.dumps(value)
    return _NOT_IN_NAMES.sub("_", text.removesuffix(".0") if isinstance(value, float) else text)


def _with_values(settings: Mapping[str, Any], values: Mapping[str, Value]) -> dict[str, Any]:
    merged = dict(settings)
    for key, value in values.items():
        section, _, rest = key.partition(".")
        inner = _with_values(merged.get(section) or {}, {rest: value}) if rest else value
        merged[section] = inner
    return merged


def _nested(key: str, value: Value) -> dict[str, Any]:
    return _with_values({}, {key: value})


def _first_twice(values: Sequence[Any]) -> Any | None:
    """Give the first value that stands there twice."""
    return next((value for value, n in Counter(values).items() if n > 1), None)


_NOTHING_SWEPT = SweptCore()

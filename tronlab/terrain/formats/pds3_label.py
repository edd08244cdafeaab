"""Labels of the Planetary Data System, version 3, as far as an image of heights needs them.

Keywords as in the Planetary Science Data Dictionary (JPL D-7116) and the PDS Standards Reference
(JPL D-7669, part 2, version 3.8).
"""

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from tronlab.terrain.formats.model import needs_extra
from tronlab.terrain.heightmap import TerrainError

Section: TypeAlias = Mapping[str, Any]
"""A label, or an object or group inside it."""

_END = re.compile(rb"^[ \t]*END[ \t]*\r?$", re.MULTILINE)
_LARGEST_LABEL_BYTES = 4_000_000


@dataclass(frozen=True, slots=True)
class Label:
    """A label and the file it was read from; errors name the file and the keyword."""

    path: Path
    sections: Section

    def image(self) -> tuple[Section, Section]:
        """Give the file description that points to an image, and the image's own description.

        Raises:
            TerrainError: There is none.
        """
        found = _first(self.sections, lambda s: "IMAGE" in s and "^IMAGE" in s)
        if found is None:
            raise self.error("describes no IMAGE (with a pointer ^IMAGE); a height map is one")
        return found, found["IMAGE"]

    def section(self, name: str) -> Section | None:
        """Give the first object or group of this name, wherever it stands."""
        found = _first(self.sections, lambda s: isinstance(s.get(name), Mapping))
        return None if found is None else found[name]

    def whole(self, section: Section, keyword: str, default: int | None = None) -> int:
        """Give a whole number, 0 or more.

        Raises:
            TerrainError: It is missing and has no default, or is none.
        """
        value = self.number(section, keyword, default)[0]
        if value < 0 or value != int(value):
            raise self.error(f"{keyword} is {value}, must be a whole number, 0 or more")
        return int(value)

    def number(
        self, section: Section, keyword: str, default: float | None = None
    ) -> tuple[float, str]:
        """Give a number and its unit in capitals, "" without one.

        Raises:
            TerrainError: It is missing and has no default, or is none.
        """
        value: Any = section.get(keyword, default)
        unit = str(getattr(value, "units", "")).upper()
        value = getattr(value, "value", value)
        if value is None:
            raise self.error(f"{keyword} is missing")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(f"{keyword} is {value!r}, must be a number")
        return value, unit

    def word(self, section: Section, keyword: str, default: str = "") -> str:
        """Give a word in capitals, with underscores for blanks."""
        return "_".join(str(section.get(keyword, default)).upper().split())

    def error(self, message: str) -> TerrainError:
        """Make an error that names the label."""
        return TerrainError(f"{self.path}: the PDS3 label {message}")


def read_label(path: Path) -> Label:
    """Read the label at the head of a file, or the one beside an image without.

    Raises:
        TerrainError: There is no label, it is damaged, or the package pvl is not installed.
    """
    text = _label_text(path)
    if text is None and path.suffix.lower() == ".img":
        beside = file_beside(path, f"{path.stem}.lbl")
        if beside is None:
            raise TerrainError(
                f"{path}: does not begin with a PDS3 label, and there is no {path.stem}.lbl beside"
                " it"
            )
        path, text = beside, _label_text(beside)
    if text is None:
        raise TerrainError(f"{path}: does not begin with a PDS3 label (PDS_VERSION_ID ... END)")
    return Label(path, _parsed(text, path))


def file_beside(path: Path, name: str) -> Path | None:
    """Find a file in the same folder whatever its case: labels and disks differ in that."""
    for file in sorted(path.parent.iterdir()):
        if file.name.lower() == name.lower() and file.is_file():
            return file
    return None


def _label_text(path: Path) -> str | None:
    with path.open("rb") as file:
        head = file.read(_LARGEST_LABEL_BYTES)
    end = _END.search(head)
    if b"PDS_VERSION_ID" not in head[:2048] or end is None:
        return None
    return head[: end.end()].decode("latin-1")


def _parsed(text: str, path: Path) -> Section:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pvl warns of optional packages when it is imported
        try:
            import pvl
            import pvl.exceptions
        except ImportError as error:
            raise needs_extra(path, "pvl") from error
    try:
        sections: Any = pvl.loads(text)
    except (
        ValueError,
        StopIteration,
        pvl.exceptions.ParseError,
        pvl.exceptions.QuantityError,
    ) as error:
        why = error.args[-1] if error.args else "it ends too early"
        raise TerrainError(f"{path}: the PDS3 label is damaged: {why}") from error
    return sections


def _first(section: Section, is_wanted: Any) -> Section | None:
    if is_wanted(section):
        return section
    for value in section.values():
        if isinstance(value, Mapping) and (found := _first(value, is_wanted)) is not None:
            return found
    return None

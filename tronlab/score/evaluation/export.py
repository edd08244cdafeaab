"""Tables as values, and the files they are written to: CSV, LaTeX, Excel, JSON and parquet.

A cell holds a number in the unit its column names; only the formatted forms round it.
"""

import csv
import io
import json
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

from tronlab.errors import ScoreError
from tronlab.score.evaluation.resampling import Estimate

if TYPE_CHECKING:
    import pandas as pd

Cell: TypeAlias = str | int | float | Estimate
PlainCell: TypeAlias = str | int | float | None
TableFormat: TypeAlias = Literal["csv", "latex", "xlsx", "json", "parquet"]

FORMATS: tuple[TableFormat, ...] = get_args(TableFormat)
MISSING = "\N{EN DASH}"
WORKBOOK = "tables.xlsx"
_LIMITS = ("", "_low", "_high")
"""Endings of the file columns that an estimate takes: its value and the ends of its interval."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column: its name in files, its heading for people, how its numbers are shown."""

    name: str
    """Name with unit suffix, as CSV has it."""
    heading: str
    form: str = ""
    """Format specification; empty for text and counts."""
    is_estimate: bool = False
    """Whether its cells are estimates: in files they take three columns."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table of the report."""

    name: str
    """File name without ending."""
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]

    @property
    def headings(self) -> tuple[str, ...]:
        """Get the headings for people."""
        return tuple(column.heading for column in self.columns)

    @property
    def formatted(self) -> tuple[tuple[str, ...], ...]:
        """Get the cells as people read them."""
        return tuple(
            tuple(
                _formatted(cell, column.form)
                for cell, column in zip(row, self.columns, strict=True)
            )
            for row in self.rows
        )

    @property
    def is_number(self) -> tuple[bool, ...]:
        """Get, for each column, whether it holds numbers, which are aligned to the right."""
        return tuple(
            bool(self.rows) and all(not isinstance(row[i], str) for row in self.rows)
            for i in range(len(self.columns))
        )

    @property
    def file_columns(self) -> tuple[str, ...]:
        """Get the names of the columns of a file."""
        return tuple(
            column.name + ending
            for column in self.columns
            for ending in (_LIMITS if column.is_estimate else ("",))
        )

    @property
    def file_rows(self) -> tuple[tuple[PlainCell, ...], ...]:
        """Get the rows of a file with every digit; None for a number there is not."""
        return tuple(
            tuple(
                plain
                for cell, column in zip(row, self.columns, strict=True)
                for plain in _plain(cell, is_estimate=column.is_estimate)
            )
            for row in self.rows
        )


def parse_formats(text: str) -> tuple[TableFormat, ...]:
    """Read ``csv,latex,xlsx,json,parquet``, or some of these.

    Raises:
        ScoreError: It names another format, or none.
    """
    names = [name.strip() for name in text.split(",")]
    odd = [name for name in names if name not in FORMATS]
    if odd:
        raise ScoreError(
            f"table format '{odd[0]}': is not known; give one or more of {','.join(FORMATS)}"
        )
    return tuple(name for name in FORMATS if name in names)


def frame_table(name: str, caption: str, frame: "pd.DataFrame") -> Table:
    """Give a table with the columns of a data frame."""
    columns = tuple(Column(str(column), str(column)) for column in frame.columns)
    lists = [frame[column].tolist() for column in frame.columns]
    return Table(name, caption, columns, tuple(zip(*lists, strict=True)))


def write_tables(folder: Path, tables: Sequence[Table], formats: Collection[TableFormat]) -> None:
    """Write tables into a folder: a file a table and format, and one workbook of all for Excel.

    Raises:
        OSError: A file cannot be written.
        ScoreError: A package that a format needs is not installed.
    """
    for name in formats:
        if name == "xlsx":
            _write_workbook(folder / WORKBOOK, tables)
            continue
        for table in tables:
            _WRITERS[name](folder, table)


def check_formats(formats: Collection[TableFormat]) -> None:
    """Refuse formats that need a package which is not installed.

    Raises:
        ScoreError: It names the extra to install.
    """
    from importlib.util import find_spec

    for name, package in (("xlsx", "openpyxl"), ("parquet", "pyarrow")):
        if name in formats and find_spec(package) is None:
            raise ScoreError(
                f"tables as {name}: need the package {package};"
                " install it with: pip install 'tronlab[tables]'"
            )


def to_csv(table: Table) -> str:
    """Write a table with full precision; a missing number is an empty cell."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(table.file_columns)
    writer.writerows([["" if cell is None else cell for cell in row] for row in table.file_rows])
    return out.getvalue()


def to_json(table: Table) -> str:
    """Write a table as an object with ``name``, ``caption``, ``columns`` and ``rows``.

    Each row is an object by name of the column; a missing number is null.
    """
    columns = table.file_columns
    document = {
        "name": table.name,
        "caption": table.caption,
        "columns": list(columns),
        "rows": [dict(zip(columns, row, strict=True)) for row in table.file_rows],
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def to_latex(table: Table) -> str:
    """Write a table for LaTeX's package booktabs."""
    lines = [
        r"\begin{tabular}{" + "".join("r" if number else "l" for number in table.is_number) + "}",
        r"\toprule",
        _latex_row(table.headings),
        r"\midrule",
        *(_latex_row(row) for row in table.formatted),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def escape_latex(text: str) -> str:
    """Make any text safe for LaTeX's text mode."""
    return "".join(_LATEX.get(character, character) for character in text)


_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "[": "{[}",  # a bare one at the start of a row would be an argument of the row before
    MISSING: "--",
}


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(escape_latex(cell) for cell in cells) + r" \\"


def _write_csv(folder: Path, table: Table) -> None:
    (folder / f"{table.name}.csv").write_text(to_csv(table), encoding="utf-8")


def _write_latex(folder: Path, table: Table) -> None:
    (folder / f"{table.name}.tex").write_text(to_latex(table), encoding="utf-8")


def _write_json(folder: Path, table: Table) -> None:
    (folder / f"{table.name}.json").write_text(to_json(table), encoding="utf-8")


def _write_parquet(folder: Path, table: Table) -> None:
    check_formats(["parquet"])
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: dict[str, Any] = {}
    for i, name in enumerate(table.file_columns):
        cells = [row[i] for row in table.file_rows]
        # Only numbers are ever missing: a column without any is still one of numbers.
        is_empty = all(cell is None for cell in cells)
        columns[name] = pa.array(cells, type=pa.float64() if is_empty else None)
    metadata = {"name": table.name, "caption": table.caption}
    pq.write_table(pa.table(columns, metadata=metadata), folder / f"{table.name}.parquet")


_WRITERS = {
    "csv": _write_csv,
    "latex": _write_latex,
    "json": _write_json,
    "parquet": _write_parquet,
}


def _write_workbook(path: Path, tables: Sequence[Table]) -> None:
    """Write each table to a sheet of its own, with its headings on top."""
    check_formats(["xlsx"])
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    for table in tables:
        sheet = book.create_sheet(table.name[:31])
        sheet.append(list(table.file_columns))
        for row in table.file_rows:
            sheet.append([_excel_cell(sheet, cell) for cell in row])
    book.save(path)


def _excel_cell(sheet: Any, cell: PlainCell) -> Any:
    """Give a cell that is what it says: a text that begins with = is no formula."""
    if not isinstance(cell, str):
        return cell
    from openpyxl.cell import WriteOnlyCell
    from openpyxl.cell.cell import ILLEGAL_CHARACTERS_RE

    text = WriteOnlyCell(sheet, ILLEGAL_CHARACTERS_RE.sub("\N{REPLACEMENT CHARACTER}", cell))
    text.data_type = "s"
    return text


def _formatted(cell: Cell, form: str) -> str:
    if isinstance(cell, Estimate):
        value, interval = _formatted(cell.value, form), cell.interval
        if interval is None:
            return value
        return f"{value} [{_formatted(interval.low, form)}, {_formatted(interval.high, form)}]"
    if _is_missing(cell):
        return MISSING
    return cell if isinstance(cell, str) else format(cell, form)


def _plain(cell: Cell, *, is_estimate: bool) -> tuple[PlainCell, ...]:
    if not isinstance(cell, Estimate):
        plain = None if _is_missing(cell) else cell
        return (plain, None, None) if is_estimate else (plain,)
    interval = cell.interval
    numbers = (cell.value, *((interval.low, interval.high) if interval else (math.nan, math.nan)))
    return tuple(None if _is_missing(number) else number for number in numbers)


def _is_missing(cell: Cell) -> bool:
    return isinstance(cell, float) and not math.isfinite(cell)

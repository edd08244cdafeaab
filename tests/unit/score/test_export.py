"""Tables in every format, read back by others' readers; text survives each of them."""

import csv
import io
import json

import numpy as np
import pandas as pd
import pytest
from openpyxl import load_workbook

from tronlab.errors import ScoreError
from tronlab.score.evaluation.export import (
    FORMATS,
    Column,
    Table,
    check_formats,
    escape_latex,
    frame_table,
    parse_formats,
    to_csv,
    to_latex,
    write_tables,
)
from tronlab.score.evaluation.resampling import Estimate, Interval

COLUMNS = (
    Column("core", "core"),
    Column("n", "shots"),
    Column("x_m", "x [m]", ".2g"),
    Column("mean_m", "mean [m]", ".2g", is_estimate=True),
)
HOSTILE = '=cmd|"/C calc"!A0, <b>\n'
TABLE = Table(
    "errors",
    "Errors",
    COLUMNS,
    (
        (HOSTILE, 3, 0.1 + 0.2, Estimate(1.0 / 3.0, Interval(0.25, np.inf))),
        ("b", 4, np.nan, Estimate(np.nan, None)),
    ),
)
NAMES = ["core", "n", "x_m", "mean_m", "mean_m_low", "mean_m_high"]
ROWS = [[HOSTILE, 3, 0.1 + 0.2, 1.0 / 3.0, 0.25, None], ["b", 4, None, None, None, None]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("tables")
    write_tables(path, [TABLE, frame_table("all", "", pd.DataFrame({"seed": [1, 2]}))], FORMATS)
    return path


def test_a_file_each_but_one_workbook(folder):
    assert {path.name for path in folder.iterdir()} == {
        *(f"{name}.{ending}" for name in ("errors", "all") for ending in ("csv", "tex", "json")),
        "errors.parquet", "all.parquet", "tables.xlsx",
    }  # fmt: skip


def test_numbers_are_exact_and_missing_ones_are_missing(folder):
    document = json.loads((folder / "errors.json").read_text(encoding="utf-8"))
    assert document["columns"] == NAMES
    assert [list(row.values()) for row in document["rows"]] == ROWS
    parquet = pd.read_parquet(folder / "errors.parquet")
    assert list(parquet.columns) == NAMES
    np.testing.assert_array_equal(parquet["x_m"], [0.1 + 0.2, np.nan])
    assert parquet["n"].tolist() == [3, 4]
    text = (folder / "errors.csv").read_text(encoding="utf-8")
    expected = [["" if cell is None else str(cell) for cell in row] for row in ROWS]
    assert list(csv.reader(io.StringIO(text))) == [NAMES, *expected]


def test_text_that_begins_like_a_formula_is_text_in_excel(folder):
    book = load_workbook(folder / "tables.xlsx")
    assert book.sheetnames == ["errors", "all"]
    rows = [[cell.value for cell in row] for row in book["errors"].iter_rows()]
    # Excel keeps fifteen digits.
    assert rows == [NAMES, *([pytest.approx(cell) for cell in row] for row in ROWS)]
    assert book["errors"]["A2"].data_type == "s"
    odd = Table("odd", "", (Column("a", "a"),), (("x\x00y",),))
    write_tables(folder, [odd], ["xlsx"])
    assert load_workbook(folder / "tables.xlsx")["odd"]["A2"].value == "x\N{REPLACEMENT CHARACTER}y"


def test_people_see_rounded_numbers_with_their_intervals():
    assert TABLE.formatted == (
        (HOSTILE, "3", "0.3", "0.33 [0.25, \N{EN DASH}]"),
        ("b", "4", "\N{EN DASH}", "\N{EN DASH}"),
    )
    assert TABLE.is_number == (False, True, True, True)


def test_csv_keeps_every_digit_and_every_character():
    text = 'a "quoted", name\nof two lines'
    table = Table(
        "t", "", (Column("name", "name"), Column("x_m", "x", ".1f")), ((text, 0.1 + 0.2),)
    )
    rows = list(csv.reader(io.StringIO(to_csv(table))))
    assert rows == [["name", "x_m"], [text, repr(0.1 + 0.2)]]


def test_latex_escapes_every_special_character():
    assert escape_latex(r"a_b & 50% #1 {x} ~ ^ $ \ < >") == (
        r"a\_b \& 50\% \#1 \{x\} \textasciitilde{} \textasciicircum{} \$ \textbackslash{}"
        r" \textless{} \textgreater{}"
    )


def test_latex_table():
    columns = (Column("core", "core"), Column("x", "mean [% LOS]", ".2g"))
    lines = to_latex(Table("t", "", columns, (("a_1", 0.123), ("[b]", np.nan)))).splitlines()
    assert lines == [
        r"\begin{tabular}{lr}",
        r"\toprule",
        r"core & mean {[}\% LOS] \\",
        r"\midrule",
        r"a\_1 & 0.12 \\",
        r"{[}b] & -- \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_formats_are_read_in_any_order_and_odd_ones_refused():
    assert parse_formats("json, csv") == ("csv", "json")
    with pytest.raises(ScoreError, match="'ods': is not known; give one or more of csv,"):
        parse_formats("csv,ods")


@pytest.mark.parametrize(("name", "package"), [("xlsx", "openpyxl"), ("parquet", "pyarrow")])
def test_a_missing_package_names_the_extra(monkeypatch, name, package):
    monkeypatch.setattr("importlib.util.find_spec", lambda found: None)
    check_formats(["csv", "json", "latex"])
    with pytest.raises(ScoreError, match=rf"{package};\s+install it .*tronlab\[tables\]"):
        check_formats([name])

"""The page about exchange names what there is."""

import re
from pathlib import Path

from tronlab.dataset.exchange.export import EXPORTERS
from tronlab.dataset.exchange.folder import REFERENCE_COLUMNS, SHOT_COLUMNS

PAGE = Path(__file__).parents[4] / "docs/reference/exchange.md"


def test_every_format_and_column_is_explained() -> None:
    named = set(re.findall(r"`(\w+)`", PAGE.read_text()))
    in_series = re.compile(r"nominal_|cov_")
    columns = {name for name in SHOT_COLUMNS + REFERENCE_COLUMNS if not in_series.match(name)}
    assert columns | set(EXPORTERS) | {"nominal_x_m", "nominal_qw", "cov_00", "cov_55"} <= named

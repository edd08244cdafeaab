from tronlab.cli.summary import summary_table


def statistics(mean: float | None, maximum: float | None, n_ok: int) -> dict[str, object]:
    return {
        "n_shots": 61,
        "n_ok": n_ok,
        "position_error_pct_los": {"mean": mean, "max": maximum},
    }


def test_table_stands_beside_the_claim_of_the_paper() -> None:
    table = summary_table(
        {"akaze": statistics(0.5, 1.25, 61), "brisk": statistics(None, None, 0)}
    ).splitlines()
    assert table[1].split() == ["akaze", "0.500", "1.250", "61/61"]
    assert table[2].split() == ["brisk", "-", "-", "0/61"]
    assert table[3].split() == ["the", "paper,", "AKAZE", "and", "BRISK", "<", "1", "<", "3"]

"""What work will cost is said by the table that knows it, and what none knows is said, too."""

from __future__ import annotations

from pathlib import Path

from twinbench.common.cost import foretold, rates_of


def test_the_first_table_that_knows_a_kind_says_what_it_costs(tmp_path: Path) -> None:
    own, other = tmp_path / "own.csv", tmp_path / "other.csv"
    own.write_text("engine,number,seconds\na,1,60\na,1,120\nb,1,\n")
    other.write_text("engine,number,seconds\na,1,9999\nb,1,30\n")
    rates = rates_of([own, other, tmp_path / "gone.csv"], ("engine", "number"))
    assert foretold("case", [("a", "1")] * 2, rates) == f"to do: 2 cases, about 3 core-minutes by {own}"
    both = f"to do: 4 cases, about 2 core-minutes by {own} and {other}; the cost of 2 is not known"
    assert foretold("case", [("a", "1"), ("b", "1"), ("c", "1"), ("a", "2")], rates) == both
    assert foretold("case", [("b", "1")], rates) == f"to do: 1 case, about a core-minute at most by {other}"
    assert "the cost is not known" in foretold("case", [("c", "1")], rates)
    assert foretold("case", [], rates) == "to do: 0 cases"
    assert rates_of([own], ())[own] == {(): 90.0}


def test_a_damaged_table_knows_nothing(tmp_path: Path) -> None:
    table = tmp_path / "own.csv"
    for text in ("", "engine\na\n", "engine,seconds\na,soon\n", "\x00\xff"):
        table.write_text(text)
        assert rates_of([table], ("engine",)) == {table: {}}

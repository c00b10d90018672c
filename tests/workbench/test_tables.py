"""Tables of answers: their files have the same bytes as those that pandas writes of the same rows."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from workbench.answer import ROWS_OF_A_PIECE, Table


@pytest.mark.parametrize("every", [1, 3])
def test_a_file_has_every_digit_and_the_types_of_its_columns(every: int) -> None:
    """Numbers of all sizes, whole ones, truth values, texts that need quotes, empty cells; in more than one piece."""
    number = ROWS_OF_A_PIECE + 1234
    draw = np.random.default_rng(0)
    x = draw.normal(size=number) * 10.0 ** draw.integers(-20, 20, size=number)
    x[5:10] = np.nan, np.inf, -0.0, 1e16, 1e-5
    rows = [
        (float(v), k, k % 2 == 0, f'a,"{k}\n' if k % 3 else None, v if k % 5 else None)
        for k, v in enumerate(x)
    ]
    table = Table.of_rows(rows, dict.fromkeys("abcde", "1"))
    frame = pd.DataFrame(rows, columns=list("abcde"))
    assert "".join(table.csv(every)) == frame.iloc[::every].to_csv(index=False, lineterminator="\n")
    assert table.frame.equals(frame)


def test_a_table_without_rows_has_its_head() -> None:
    assert "".join(Table.of_rows([], {"a": "1", "b": "s"}).csv()) == "a,b\n"

"""Arguments of machine code: names that the time loop and the runner share."""

from diagramc.native.arguments import (
    MEMO_LINES,
    NOT_FINITE,
    OK,
    OUTPUT_NOT_FINITE,
    OUTSIDE,
    TOO_ROUGH,
)


def test_outcomes_differ_and_a_run_to_its_end_is_zero():
    outcomes = (OK, NOT_FINITE, OUTSIDE, TOO_ROUGH, OUTPUT_NOT_FINITE)
    assert len(set(outcomes)) == 5
    assert OK == 0  # a status is tested for truth


def test_a_table_has_a_row_for_each_count_of_a_12_bit_encoder():
    assert MEMO_LINES & (MEMO_LINES - 1) == 0  # a row is chosen by a mask
    assert MEMO_LINES >= 2**12

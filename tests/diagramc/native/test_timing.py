"""The tick of a run."""

import numpy as np
import pytest

from diagramc.errors import CompilationError
from diagramc.native.timing import timing as timing_of


@pytest.mark.parametrize(
    ("periods", "record", "tick", "counts"),
    [
        (((0.002, 0.0),), None, 0.002, [1, 1, 0]),
        (((0.002, 0.0), (0.003, 0.0)), 0.006, 0.001, [6, 2, 0, 3, 0]),
        (((1 / 3, 0.25),), None, 1 / 12, [4, 4, 3]),
        ((), 0.1, 0.1, [1]),
    ],
)
def test_tick_divides_all_times(periods, record, tick, counts):
    timing = timing_of(periods, record)
    assert timing.tick == pytest.approx(tick, rel=1e-15)
    assert timing.record_every == counts[0]
    assert timing.periods.tolist() == counts[1::2]
    assert timing.offsets.tolist() == counts[2::2]


def test_sample_times_without_common_divisor_are_refused():
    with pytest.raises(CompilationError, match="no common divisor"):
        timing_of(((0.002, 0.0), (0.002 * np.sqrt(2.0), 0.0)), None)
    with pytest.raises(ValueError, match="record_period_s is needed"):
        timing_of((), None)


def test_the_first_record_at_a_time_or_later():
    for grid in (timing_of(((0.002, 0.0),), None), timing_of(((0.003, 0.001),), 0.01, 2e-3)):
        times = grid.record_times(3000)
        chosen = np.concatenate(
            [times, np.nextafter(times, 9.0), np.nextafter(times, -9.0), [-1.0]]
        )
        rows = np.searchsorted(times, chosen)
        np.testing.assert_array_equal(grid.record_after(chosen), rows)
        assert times[-1] == grid.times(3000)


def test_a_note_names_the_offset_that_makes_many_ticks():
    offset = timing_of(((0.01, 0.0), (0.02, 1e-6)), None)
    note = offset.offset_note(2_000_000)
    assert note.startswith(
        "an update every 0.02 s with an offset of 1e-06 s makes 2000000 ticks of 1e-06 s; "
    )
    assert offset.offset_note(10_000) == ""
    records = timing_of(((0.01, 0.0),), 1e-6)
    assert records.offset_note(2_000_000) == ""  # the ticks are those of the records

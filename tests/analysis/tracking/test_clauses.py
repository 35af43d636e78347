"""The clauses about a run: what the page, whose tests compare its sentences, can fill."""

import re

from kneexo.analysis.tracking.clauses import CAUSES, CLAUSES, said
from kneexo.parameters.device.safety_states import REASONS


def test_a_page_can_fill_every_clause():
    """JavaScript knows numbers with significant digits, and the cause."""
    for text in CLAUSES.values():
        assert not re.search(r"[{}]", re.sub(r"\{(\w+:\.\dg|cause)\}", "", text)), text


def test_clauses_follow_each_other_and_each_reason_has_words():
    numbers = {"time_s": 1.23456, "cause": CAUSES["flow"], "safe_ms": 20.0}
    assert said("stopped", "safe", **numbers) == (
        "Stopped at 1.235 s by the detector flow; safe 20 ms after it"
    )
    assert tuple(CAUSES) == REASONS

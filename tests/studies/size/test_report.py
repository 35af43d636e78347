from __future__ import annotations

import dataclasses

from kneexo.studies.size.report import report


def test_the_report_says_that_the_hardware_does_not_walk_and_that_no_gains_do(by_hand):
    text = report(dataclasses.replace(by_hand, steps={"ample": by_hand.steps["ample"]}))
    assert "as it is: the run fails, t = 1 s: left the range." in text
    gains = by_hand.best_gains | {"meets": False}
    assert (
        "none of the 6 gains tried has a disk margin of 0.5 without chattering** (this one: 0.01)"
    ) in report(dataclasses.replace(by_hand, best_gains=gains))

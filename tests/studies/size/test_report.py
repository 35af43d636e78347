from __future__ import annotations

import dataclasses

from kneexo.studies.size.report import report


def test_the_report_says_that_the_hardware_does_not_walk_and_that_no_gains_do(sized):
    text = report(dataclasses.replace(sized, steps={"ample": sized.steps["ample"]}))
    assert "as it is: the run fails, t = 1 s: left the range." in text
    gains = sized.best_gains | {"meets": False}
    assert (
        "none of the 6 gains tried has a disk margin of 0.5 without chattering** (this one: 0.01)"
    ) in report(dataclasses.replace(sized, best_gains=gains))

"""Each number of the report on the study `wearer` is that of its row."""

from dataclasses import replace

from kneexo.parameters.paths import changed
from kneexo.studies.wearer.report import report


def test_a_dagger_marks_the_runs_below_vacuum(by_hand):
    assert "† The pressure of a chamber falls below -0.1 MPa" in report(by_hand)
    rows = tuple(replace(row, lowest_pressure_pa=-0.99e5) for row in by_hand.transparency)
    assert "†" not in report(replace(by_hand, transparency=rows))


def test_the_assumptions_have_the_seal_friction(by_hand):
    stiff = changed(by_hand.scenario, {"plant.full_order.coulomb_friction_n": 12.0})
    reduced = changed(by_hand.scenario, {"plant.full_order": None})
    text = " ".join(report(replace(by_hand, scenario=stiff)).split())
    assert "seal friction of the cylinder is 12 N. The preset `wearer` has 40 N." in text
    assert "seal friction" not in report(replace(by_hand, scenario=reduced))

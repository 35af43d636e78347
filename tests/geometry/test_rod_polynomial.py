"""The polynomials that a controller uses when its scenario gives none."""

import numpy as np
import pytest

from kneexo.analysis import fit_polynomials, track
from kneexo.analysis.frequency.bandwidth import rod_of
from kneexo.errors import LinkageError
from kneexo.geometry.linkage import rod_extension
from kneexo.geometry.rod_polynomial import (
    completed,
    controller_polynomial,
    fitted_polynomial,
    largest_error_mm,
)
from kneexo.law.decision import known_to_controller
from kneexo.parameters import TABLE_1_LINKAGES, LinkageParameters, RodPolynomialParameters, Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation.compiled import scenario_values, structure_key

TABLE_1 = RodPolynomialParameters()
LONGER = {"rod_pin_radius_m": 0.27}
OWN = Scenario(plant={"linkage": LONGER})
LINK = OWN.plant.linkage


@pytest.mark.parametrize("name", TABLE_1_LINKAGES)
def test_the_linkages_identified_from_table_1_keep_it(name):
    scenario = Scenario(plant={"linkage": name})
    assert controller_polynomial(scenario) == TABLE_1
    assert largest_error_mm(scenario.plant.linkage, TABLE_1) < 0.22


def test_another_linkage_has_a_polynomial_fitted_to_it():
    fit = fit_polynomials(LINK)
    fitted = controller_polynomial(OWN)
    assert fitted == fitted_polynomial(LINK)
    # Eight digits of coefficients change the 100 mm of x by 1e-5 mm at most.
    rod_mm = np.polyval(fitted.p_mm_deg, fit.angle_deg)
    np.testing.assert_allclose(rod_mm, np.polyval(fit.p_mm_deg, fit.angle_deg), atol=1e-4, rtol=0)
    angle_deg = np.polyval(fitted.q_deg_mm, fit.extension_mm)
    np.testing.assert_allclose(
        angle_deg, np.polyval(fit.q_deg_mm, fit.extension_mm), atol=1e-4, rtol=0
    )
    exact_mm = 1e3 * rod_extension(LINK, np.radians(fit.angle_deg))
    error = largest_error_mm(LINK, fitted)
    assert error == pytest.approx(np.abs(rod_mm - exact_mm).max(), rel=1e-9)
    assert error < 0.1 < 3.0 < largest_error_mm(LINK, TABLE_1)


def test_the_controller_knows_the_polynomial_of_the_plant_it_believes_in():
    misjudged = changed(OWN, {"nominal": Scenario().plant})
    assert controller_polynomial(misjudged) == TABLE_1
    assert controller_polynomial(changed(Scenario(), {"nominal": OWN.plant})) == fitted_polynomial(
        LINK
    )
    assert known_to_controller(OWN).polynomial == fitted_polynomial(LINK)


def test_a_given_polynomial_stays():
    given = changed(OWN, {"polynomial": {"p_mm_deg": TABLE_1.p_mm_deg}})
    assert controller_polynomial(given) == TABLE_1
    assert completed(given).polynomial == TABLE_1


def test_a_fit_follows_a_change_of_the_linkage():
    shorter = changed(OWN, {"plant.linkage.rod_length_m": 0.22})
    change_mm = 1e3 * (LINK.rod_length_m - 0.22)
    p_6, p_6_before = (controller_polynomial(s).p_mm_deg[-1] for s in (shorter, OWN))
    assert p_6 - p_6_before == pytest.approx(change_mm, abs=1e-4)


def test_a_completed_scenario_is_the_same_run():
    explicit = completed(OWN)
    assert explicit.polynomial == fitted_polynomial(LINK)
    assert explicit.simulation.duration_s == 30.0
    assert explicit.model_copy(update={"polynomial": None, "simulation": OWN.simulation}) == OWN
    assert structure_key(explicit) == structure_key(OWN)  # one compiled model serves both
    assert scenario_values(explicit) == scenario_values(OWN)


def test_the_values_of_a_run_are_those_of_the_fit():
    values, p_6 = scenario_values(OWN), controller_polynomial(OWN).p_mm_deg[-1]
    for part in ("coordinates", "rod_reference"):
        assert values[f"controller/{part}.p_6"] == pytest.approx(1e-3 * p_6, rel=1e-12)


def test_a_plant_whose_rod_follows_the_polynomial_follows_the_fit():
    scenario = changed(OWN, {"plant.rod_map": "polynomial", "simulation.duration_s": 0.01})
    rod_m = 1e-3 * np.polyval(controller_polynomial(OWN).p_mm_deg, 10.0)
    first = track(scenario, all_signals=True).run["rod_extension_m"][0]
    assert first == pytest.approx(rod_m, rel=1e-9)
    assert rod_of(scenario, np.radians(10.0)) == pytest.approx(rod_m, rel=1e-9)


def test_a_wide_cylinder_has_coefficients_too():
    """θ_p(x) far from x = 0 has large coefficients."""
    far = LinkageParameters(rod_length_m=0.03)
    assert fitted_polynomial(far).q_deg_mm[-1] > 3e3


def test_a_linkage_that_cannot_be_assembled_is_refused():
    with pytest.raises(LinkageError, match="cannot be assembled"):
        controller_polynomial(Scenario(plant={"linkage": {"a_2_m": 0.2}}))

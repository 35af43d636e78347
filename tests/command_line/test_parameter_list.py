import json
import re

from kneexo.command_line.parameter_list import (
    listing,
    mark_changes,
    matching,
    parameter_rows,
    setting_rows,
    uncertainty_rows,
)
from kneexo.geometry.rod_polynomial import completed
from kneexo.parameters import CylinderParameters, Scenario
from kneexo.parameters.fields.fields import source_of
from kneexo.parameters.paths import changed
from kneexo.studies.catalogue import STUDIES


def test_every_listed_setting_can_be_set():
    """`kneexo params` lists a setting under the name that ``--set`` takes."""
    for cls in (Scenario, *(study.computation().settings for study in STUDIES.values())):
        for row in parameter_rows(cls()):
            name = row["parameter"]
            assert changed(cls(), {name: row["value"]}) == cls(), name


def rows_of(scenario, *, all_kinds=False):
    rows = list(parameter_rows(scenario, all_kinds=all_kinds))
    mark_changes(rows, scenario)
    return {row["parameter"]: row for row in rows}


def test_a_changed_value_is_the_users_or_of_a_preset_and_keeps_its_source():
    values = {"plant.cylinder.mass_kg": 2.0, "plant.pump.lag_s": 0.02, "plant.linkage": "G3"}
    rows = rows_of(Scenario.preset("leg").changed(values))
    fields = CylinderParameters.model_fields
    source = source_of(fields["mass_kg"])
    mass = rows["plant.cylinder.mass_kg"]
    assert mass["provenance"] == f"yours (paper: 1.6; {source})"
    assert (mass["value"], mass["default"]) == (2.0, 1.6)
    assert rows["plant.pump.lag_s"]["provenance"].startswith("yours (default: 0.01; assumption: ")
    friction = rows["plant.full_order.coulomb_friction_n"]["provenance"]
    assert friction.startswith("of the preset leg (default: 0; ")
    assert rows["plant.linkage.a_2_m"]["provenance"].startswith("assumption: identified")
    assert rows["plant.cylinder.bore_m"]["provenance"] == source_of(fields["bore_m"])
    own = rows_of(Scenario(plant={"linkage": {"a_2_m": 0.033}}))["plant.linkage.a_2_m"]
    assert own["provenance"].startswith("yours (default: 0.0329701; ")


def test_what_the_user_left_out_is_fitted_and_not_the_users():
    """The list has the polynomial that is fitted to the linkage, and the duration."""
    named = []
    for scenario in (Scenario(), Scenario(plant={"linkage": {"a_2_m": 0.033}})):
        rows = list(parameter_rows(completed(scenario)))
        mark_changes(rows, scenario)
        named.append({row["parameter"]: row["provenance"] for row in rows})
    paper, own = named
    source = paper["polynomial.p_mm_deg"]
    assert source.startswith("Table 1: ")
    assert own["polynomial.p_mm_deg"] == f"fitted to the linkage (paper: {source})"
    yours = [name for name, source in own.items() if source.startswith("yours")]
    assert yours == ["plant.linkage.a_2_m"]


def test_samples_are_listed_by_their_ends():
    angles = tuple(20.0 + 0.1 * n for n in range(100))
    reference = {"kind": "samples", "times_s": tuple(map(float, range(100))), "angles_deg": angles}
    rows = rows_of(Scenario(reference=reference))
    row = rows["reference.times_s"]
    assert (row["default"], row["provenance"][:17]) == ("(required)", "given by the user")
    assert "times_s = [0, 1, …, 99] (100 values) s" in listing([row], grouped=False)
    json.dumps(list(rows.values()))  # every value has a form in JSON


def test_no_line_is_above_100_columns_and_no_row_is_lost():
    rows = [*parameter_rows(Scenario(), all_kinds=True), *setting_rows(), *uncertainty_rows()]
    for grouped in (True, False):
        lines = listing(rows, grouped=grouped).splitlines()
        assert max(map(len, lines)) <= 100
        assert sum(" = " in line and line[-1] != ":" for line in lines) >= len(rows)
    listed = set(re.split(r"\s", listing(rows)))
    names = [row["parameter"].rpartition(": ")[::2] for row in rows]
    assert {name if group else name.rpartition(".")[2] for group, name in names} <= listed


def test_a_row_is_one_line_where_it_fits_under_the_heading_of_its_group():
    rows = list(parameter_rows(Scenario(), all_kinds=True))
    text = listing(rows)
    assert "\n\nplant.cylinder:\n  bore_m = 0.02 m  [0.001 … 1]  Table 3\n" in text
    assert "\n\nplant.load = knee:\n  segment_mass_kg = 1.6 kg  [0 … 200]\n      Table 3: " in text
    assert "\n\nplant.full_order = true:\n  dead_volume_m3 = 5e-06 m³" in text
    assert "\n  o_a_y_m = -0.034732 m  [-2 … 2]  as above\n" in text
    assert "\n\nscenario:\n  polynomial = left out\n" in text
    titles = [line for line in text.splitlines() if line and line[0] != " "]
    assert len(titles) == len(set(titles))


def test_find_looks_into_names_units_and_provenance():
    rows = list(parameter_rows(Scenario(), all_kinds=True))
    names = {row["parameter"] for row in matching(rows, "MASS")}
    assert {"plant.cylinder.mass_kg", "plant.load(knee).segment_mass_kg"} <= names
    assert "plant.load(knee).centre_of_mass_m" in names
    assert "plant.pump.gear_ratio" in {row["parameter"] for row in matching(rows, "section 5")}
    assert {row["unit"] for row in matching(rows, "m³/(s·Pa)")} == {"m³/(s·Pa)"}
    line = listing(matching(rows, "segment_mass_kg"), grouped=False)
    assert line.startswith("plant.load.segment_mass_kg = 1.6 kg  [0 … 200]\n    Table 3: shank, ")
    assert line.endswith("; needs plant.load = knee\n")

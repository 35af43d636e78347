from kneexo.command_line.parameter_list import parameter_rows
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.studies.catalogue import STUDIES


def test_every_listed_setting_can_be_set():
    """`kneexo params` lists a setting under the name that ``--set`` takes."""
    for cls in (Scenario, *(study.settings for study in STUDIES.values())):
        for row in parameter_rows(cls()):
            name = row["parameter"]
            assert changed(cls(), {name: row["value"]}) == cls(), name

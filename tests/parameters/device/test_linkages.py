"""The geometries have names."""

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    G1,
    G2,
    G3,
    G4,
    G5,
    HINGE,
    LINKAGES,
    LinkageParameters,
    PlantParameters,
)


def test_linkage_may_be_named() -> None:
    assert LINKAGES == {"G1": G1, "G2": G2, "G3": G3, "G4": G4, "G5": G5, "hinge": HINGE}
    assert len({G1, G2, G3, G4, G5, HINGE}) == 6
    assert LinkageParameters() == G1 == PlantParameters().linkage
    assert PlantParameters(linkage="G3").linkage is G3


def test_an_unknown_name_of_a_linkage_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ParameterError, match=r"'G9': must be G1, .*, G5, hinge or a mapping"):
        PlantParameters(linkage="G9")

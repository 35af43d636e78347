"""The geometries have names."""

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

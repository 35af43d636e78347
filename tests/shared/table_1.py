"""Table 1 of Lee et al. 2020 as it is printed, and linkages beside its own."""

from kneexo.parameters import LinkageParameters

P_MM_DEG = (1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0)
THETA_4_DEG = {
    "G1": (82.524, -4.705),
    "G2": (-101.947, -189.267),
    "G3": (-87.669, 38.729),
    "G4": (-89.714, 20.804),
    "G5": (-46.607, 134.773),
    "hinge": (-60.0, 30.0),
}


def changed(link, **values):
    return LinkageParameters(**(link.model_dump() | values))

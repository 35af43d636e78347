"""kneexo: a polycentric knee exoskeleton with electro-hydraulic actuator, on Drake.

Subpackages: ``kneexo.systems`` (leaf systems), ``kneexo.diagrams`` (builders),
``kneexo.compilation`` (diagrams as machine code) and ``kneexo.analysis``; ``kneexo.parameters``
holds every physical number, ``kneexo.linkage`` the four-bar mathematics as plain functions.
"""

from typing import Any

__version__ = "0.1.0"


def compile(system: Any, **options: Any) -> Any:  # noqa: A001
    """Compile a scenario, a scenario file or a diagram: see `kneexo.simulation.compile_model`."""
    from kneexo.simulation import compile_model  # numba and Drake only when asked for

    return compile_model(system, **options)

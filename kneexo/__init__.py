"""kneexo: a polycentric knee exoskeleton with electro-hydraulic actuator, on Drake.

Subpackages: ``kneexo.systems`` (leaf systems), ``kneexo.diagrams`` (builders),
``kneexo.compilation`` (diagrams as machine code) and ``kneexo.analysis``; ``kneexo.parameters``
holds every physical number, ``kneexo.linkage`` the four-bar mathematics as plain functions.
"""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import TYPE_CHECKING, overload

if TYPE_CHECKING:
    from pydrake.systems.framework import System

    from kneexo.compilation import CompiledModel, DiagramModel
    from kneexo.parameters import Scenario

__version__ = "0.1.0"


@overload
def compile(system: Scenario | str | PathLike[str]) -> CompiledModel: ...  # noqa: A001


@overload
def compile(system: System, *, inputs: Iterable[str] = ()) -> DiagramModel: ...  # noqa: A001


def compile(  # noqa: A001
    system: Scenario | str | PathLike[str] | System, *, inputs: Iterable[str] = ()
) -> CompiledModel:
    """Compile a scenario, a scenario file or a diagram: see `kneexo.simulation.compile_model`.

    ``inputs``: names of the input ports of a diagram that stay inputs of the model.
    """
    from kneexo.simulation import compile_model  # LLVM and Drake only when asked for

    return compile_model(system, inputs=inputs)

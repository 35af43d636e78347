"""The C statements of the elimination that the Rosenbrock method requires."""

from __future__ import annotations

from ..rosenbrock import Elimination, Operation
from .printer import Precision, literal


def factorization(elimination: Elimination, real: Precision) -> list[str]:
    """Return C statements that factorize the matrix d I - J.

    The statements read the array ``jacobian``, in the order of `Elimination.entries`, and the
    variable ``diagonal``, which is d. They write the elements of the factors to the array ``a``.
    ``real`` is the floating-point type of the code.
    """
    lines = []
    for place, (row, column) in enumerate(elimination.entries):
        start = "diagonal - " if row == column else "-"
        lines.append(f"    real a{place} = {start}jacobian[{place}];")
    for place in range(len(elimination.entries), elimination.size):
        lines.append(f"    real a{place} = {literal(0.0, real)};")
    for step in elimination.factorization:
        lines.append(_statement(f"a{step.target}", step, f"a{step.factor}", f"a{step.other}", real))
    return [*lines, *(f"    a[{place}] = a{place};" for place in range(elimination.size))]


def solution(elimination: Elimination, real: Precision) -> list[str]:
    """Return C statements that replace the right side ``b`` of a system by the solution.

    The statements read the array ``a`` of `factorization`.
    """
    size = max(row for row, _ in elimination.entries) + 1
    lines = [f"    real b{row} = b[{row}];" for row in range(size)]
    for step in elimination.substitution:
        factor = f"a[{step.factor}]"
        lines.append(_statement(f"b{step.target}", step, factor, f"b{step.other}", real))
    return [*lines, *(f"    b[{row}] = b{row};" for row in range(size))]


def _statement(target: str, step: Operation, factor: str, other: str, real: Precision) -> str:
    """Return the C statement of an operation, whose numbers have these texts."""
    if step.factor is None:
        return f"    {target} = {literal(1.0, real)} / {target};"
    if step.other is None:
        return f"    {target} *= {factor};"
    return f"    {target} -= {factor} * {other};"

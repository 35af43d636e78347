"""The Rosenbrock method, which takes long steps where the equations are stiff.

A step of the length h leads from the state x at the time t to x + Σ m_i u_i. Let f be dx/dt, J the
Jacobian ∂f/∂x and f_t = ∂f/∂t, both at the start of the step. The stages u_i follow from systems of
linear equations with one matrix (Hairer and Wanner 1996, Solving Ordinary Differential Equations
II, Eq. IV.7.25):

    (1/(γ h) I - J) u_i = f(t + α_i h, x + Σ_j a_ij u_j) + Σ_j c_ij/h u_j + γ_i h f_t,  j < i.

The matrix is factorized without row exchanges, as in the Kinetic PreProcessor (Sandu et al. 1997,
Atmos. Environ. 31). So the places of its nonzero elements are known when the code is made, and the
code skips all others. A pivot that is zero or small makes the error estimate large or not finite.
Then the step is repeated with a shorter length, with which 1/(γ h) dominates.

The substeps of a tick are the steps that meet the tolerance. Exported C and machine code have the
coefficients, the order of the elimination and the control of the substeps from here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from .errors import CompilationError

MOST_SUBSTEPS = 1000
"""Largest number of substeps in a tick, rejected ones included.

A call of exported C must end in a known time, so each of its loops has a largest number of passes.
"""

TOLERANCES = {"double": 1e-7, "float": 1e-5}
"""Default tolerance by precision.

The sum over all states of error estimate / (1 + \\|state\\|) of a substep is at most the tolerance.
On preset ``leg``, 1e-5, 1e-6 and 1e-7 make errors of the load pressure of 1.8e-3, 2.6e-4 and 2.3e-5
of its peak (``benchmarks/stiff.py``).
"""

TOLERANCE_RANGES = {"double": (1e-12, 1e-2), "float": (1e-6, 1e-2)}
"""Smallest and largest tolerance by precision; below, rounding errors would miss the tolerance."""

_MOST_OPERATIONS = 20_000  # of the elimination: a compiler takes seconds for more


@dataclass(frozen=True)
class SubstepControl:
    """How the length of the next substep follows from the error estimate of a substep.

    Let e be the error estimate divided by the tolerance. The next substep is longer by the factor
    ``safety`` / e^(1/4), but at least by ``least`` and at most by ``most``.
    """

    safety: float = 0.9
    least: float = 0.1
    most: float = 5.0
    whole: float = 0.9999
    """A substep that is longer than this share of the rest of the tick ends with the tick.

    Below 1, so that rounding leaves no last substep of almost zero length.
    """
    share: float = 0.5
    """All other substeps take at most this share of the rest, so that none is very short."""

    @property
    def easy(self) -> float:
        """The value e up to which the next substep is longer by the factor ``most``."""
        return (self.safety / self.most) ** 4


CONTROL = SubstepControl()
"""The control of exported C and of machine code."""


@dataclass(frozen=True)
class RosenbrockMethod:
    """The coefficients of a Rosenbrock method, in the notation of this module."""

    gamma: float
    nodes: tuple[float, ...]
    """α_i of each stage."""
    time_factors: tuple[float, ...]
    """γ_i of each stage."""
    state_factors: tuple[tuple[float, ...], ...]
    """a_ij, a row for each stage."""
    rate_factors: tuple[tuple[float, ...], ...]
    """c_ij, a row for each stage."""
    weights: tuple[float, ...]
    """m_i of each stage."""
    error_weights: tuple[float, ...]
    """Factors of the stages in the error estimate, the difference from an embedded method."""


_ROW_5 = (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950)

RODAS = RosenbrockMethod(
    gamma=0.25,
    nodes=(0.0, 0.386, 0.21, 0.63, 1.0, 1.0),
    time_factors=(0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0),
    state_factors=(
        (),
        (1.544,),
        (0.9466785280815826, 0.2557011698983284),
        (3.314825187068521, 2.896124015972201, 0.9986419139977817),
        _ROW_5,
        (*_ROW_5, 1.0),
    ),
    rate_factors=(
        (),
        (-5.6688,),
        (-2.430093356833875, -0.2063599157091915),
        (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
        (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
        (
            8.083246795921522,
            -7.981132988064893,
            -31.52159432874371,
            16.31930543123136,
            -6.058818238834054,
        ),
    ),
    weights=(*_ROW_5, 1.0, 1.0),
    error_weights=(0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
)
"""RODAS of Hairer and Wanner (1996), order 4 with an embedded method of order 3.

Both methods are L-stable and stiffly accurate. The coefficients are those of their program RODAS.
"""


class Operation(NamedTuple):
    """An operation of `Elimination` on a number with the index ``target``.

    The number becomes its inverse. With a ``factor`` it is multiplied by this factor instead. With
    a ``factor`` and an ``other`` number their product is subtracted from it.
    """

    target: int
    factor: int | None = None
    other: int | None = None


class Elimination:
    """Operations that factorize the matrix d I - J, and that solve systems with its factors.

    Attributes
    ----------
    entries
        Places (row, column) of the elements of J that are not always zero, and of its diagonal.
    size
        Number of elements of the factors: the elements of ``entries``, then those that the
        elimination adds, which are zero at first.
    factorization
        Operations on the elements a of d I - J, which become the elements of the factors.
    substitution
        Operations on the elements b of the right side, which become the solution. ``factor`` is the
        index of an element of the factors, the other indices are those of elements b.
    operations
        Dictionary from an operator to its number of executions in one factorization and ``solves``
        solutions.

    Raises
    ------
    CompilationError
        The elimination of a matrix with so many elements takes too many operations.
    """

    def __init__(self, rows: Sequence[Iterable[int]], solves: int) -> None:
        """Find the operations.

        Parameters
        ----------
        rows
            For each row of J the columns whose elements are not always zero.
        solves
            Number of systems that a factorization serves.
        """
        self.entries = [
            (row, column) for row, columns in enumerate(rows) for column in sorted({row, *columns})
        ]
        self._at = {entry: place for place, entry in enumerate(self.entries)}
        self.factorization: list[Operation] = []
        order = self._eliminate(len(rows))
        self.size = len(self._at)
        self.substitution = self._substituted(order)
        self.operations: Counter[str] = Counter()
        for steps, times in ((self.factorization, 1), (self.substitution, solves)):
            self.operations["/"] += times * sum(step.factor is None for step in steps)
            self.operations["*"] += times * sum(step.factor is not None for step in steps)
            self.operations["+"] += times * sum(step.other is not None for step in steps)
        if sum(self.operations.values()) > _MOST_OPERATIONS:
            raise CompilationError(
                f"integrator = 'rosenbrock': {len(rows)} states that depend on each other take "
                f"{sum(self.operations.values())} operations in a substep; must be at most "
                f"{_MOST_OPERATIONS}; choose another integrator"
            )

    def _place(self, row: int, column: int) -> int:
        """Return the index of an element of the factors; a new element gets the next index."""
        return self._at.setdefault((row, column), len(self._at))

    def _eliminate(self, size: int) -> list[int]:
        """Append the operations that eliminate one pivot after the other; return their order.

        The next pivot is that of the diagonal which adds the fewest products (Markowitz 1957).
        """
        left, order = set(range(size)), list[int]()
        while left:
            below = {k: [i for i in left if i != k and (i, k) in self._at] for k in left}
            right = {k: [j for j in left if j != k and (k, j) in self._at] for k in left}
            # The index decides between equal numbers: equal matrices then give equal code.
            pivot = min(left, key=lambda k: (len(below[k]) * len(right[k]), k))
            left.remove(pivot)
            order.append(pivot)
            inverse = self._place(pivot, pivot)
            self.factorization.append(Operation(inverse))
            for row in sorted(below[pivot]):
                factor = self._place(row, pivot)
                self.factorization.append(Operation(factor, inverse))
                for column in sorted(right[pivot]):
                    changed, known = self._place(row, column), self._place(pivot, column)
                    self.factorization.append(Operation(changed, factor, known))
        return order

    def _substituted(self, order: Sequence[int]) -> list[Operation]:
        """Return the operations that solve a sparse linear system with the factors.

        Elimination with the pivots of ``order`` comes first, then back substitution.
        """
        rank = {row: number for number, row in enumerate(order)}
        steps = [
            Operation(row, self._at[row, column], column)
            for column in order
            for row in order[rank[column] + 1 :]
            if (row, column) in self._at
        ]
        for row in reversed(order):
            for column in order[rank[row] + 1 :]:
                if (row, column) in self._at:
                    steps.append(Operation(row, self._at[row, column], column))
            steps.append(Operation(row, self._at[row, row]))
        return steps

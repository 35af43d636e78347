"""Types of values in LLVM IR: an element type, and the number of vector lanes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Type:
    """An LLVM type: the scalar type ``element``, or a vector if ``lanes`` is more than 1."""

    element: str
    lanes: int = 1

    def __str__(self) -> str:
        return self.element if self.lanes == 1 else f"<{self.lanes} x {self.element}>"

    def of(self, lanes: int) -> Type:
        """Return the type with the same elements as this type, but ``lanes`` lanes."""
        return Type(self.element, lanes)

    @property
    def suffix(self) -> str:
        """Suffix for this type in names of LLVM's intrinsics, such as ``v8f64`` for 8 doubles."""
        name = {"double": "f64"}.get(self.element, self.element)
        return name if self.lanes == 1 else f"v{self.lanes}{name}"


DOUBLE, INT, BOOL, BYTE, POINTER = (Type(name) for name in ("double", "i64", "i1", "i8", "ptr"))
"""Scalar types (one lane) of the emitted code."""

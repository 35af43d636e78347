"""The types of LLVM IR."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Type:
    """An LLVM type: an element, or a vector of ``lanes`` of them."""

    element: str
    lanes: int = 1

    def __str__(self) -> str:
        return self.element if self.lanes == 1 else f"<{self.lanes} x {self.element}>"

    def of(self, lanes: int) -> Type:
        """Return the type with the same element in another number of lanes."""
        return Type(self.element, lanes)

    @property
    def suffix(self) -> str:
        """Part of the name of an intrinsic that says this type, such as ``v8f64``."""
        name = {"double": "f64"}.get(self.element, self.element)
        return name if self.lanes == 1 else f"v{self.lanes}{name}"


DOUBLE, INT, BOOL, BYTE, POINTER = (Type(name) for name in ("double", "i64", "i1", "i8", "ptr"))
"""The types that the compiler uses, with one lane."""

"""Control laws of the user, each compiled, or called as Python once a sample.

`kneexo.parameters.Law` is the law with its name, its file and its arguments. This folder has its
way into a loop: `FunctionLaw` for a law that is a function, `HeldCommand` for a law that is called
as Python beside a compiled plant, and `LinearLaw` for such a law near an operating point.
"""

from kneexo.law.leaves import (
    FunctionLaw,
    FunctionLaw_,
    HeldCommand,
    HeldCommand_,
    LinearLaw,
    LinearLaw_,
)

__all__ = [
    "FunctionLaw",
    "FunctionLaw_",
    "HeldCommand",
    "HeldCommand_",
    "LinearLaw",
    "LinearLaw_",
]

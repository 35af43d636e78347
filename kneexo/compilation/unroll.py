"""Loops over the states written out, and vectors of states as scalars.

Arrays may overlap, so a compiler reads and writes each of their elements in turn; scalars stay in
registers.
"""

from __future__ import annotations

import ast
import copy
import operator
from collections.abc import Sequence
from typing import Any

_COUNT = "STATE_COUNT"
_FOLDED = {ast.Add: operator.add, ast.Mult: operator.mul}


def unrolled(text: str, size: int) -> str:
    """The text of a module with its ``@unrolled("x f")`` functions written out for ``size`` states.

    In such a function ``for i in range(STATE_COUNT)`` is repeated, and the named vectors become
    scalars: ``x[i]`` is ``x_0``, ``x_1`` …; a vector as an argument, result or target stands for
    all of its elements. The decorator becomes ``@inline``.
    """
    tree = ast.parse(text)
    tree.body = [_function(node, size) for node in tree.body]
    return ast.unparse(ast.fix_missing_locations(tree))


def _function(node: ast.stmt, size: int) -> ast.stmt:
    if not isinstance(node, ast.FunctionDef):
        return node
    for decorator in node.decorator_list:
        if isinstance(decorator, ast.Call) and getattr(decorator.func, "id", "") == "unrolled":
            (names,) = (ast.literal_eval(argument) for argument in decorator.args)
            node.decorator_list = [ast.Name("inline", ast.Load())]
            if not size:  # nothing to do
                result = "OK" if node.name.startswith("advance") else "()"
                node.body = ast.parse(f"return {result}").body
            return _Unroller(names.split(), size).visit(node)
    return node


class _Unroller(ast.NodeTransformer):
    def __init__(self, vectors: Sequence[str], size: int) -> None:
        self.vectors = set(vectors)
        self.size = size
        self.indices: dict[str, int] = {}

    def _elements(self, node: Any) -> list[Any]:
        """A vector's elements; of any other node itself."""
        if isinstance(node, ast.Name) and node.id in self.vectors:
            return [ast.Name(f"{node.id}_{n}", node.ctx) for n in range(self.size)]
        return [self.visit(node)]

    def _value(self, node: Any) -> Any:
        """A vector as a tuple; any other node itself."""
        is_vector = isinstance(node, ast.Name) and node.id in self.vectors
        return ast.Tuple(self._elements(node), node.ctx) if is_vector else self.visit(node)

    def visit_arguments(self, node: ast.arguments) -> ast.arguments:
        node.args = [
            element
            for argument in node.args
            for element in (
                [ast.arg(f"{argument.arg}_{n}") for n in range(self.size)]
                if argument.arg in self.vectors
                else [argument]
            )
        ]
        return node

    def visit_For(self, node: ast.For) -> Any:
        match node:
            case ast.For(
                target=ast.Name(id=index),
                iter=ast.Call(func=ast.Name(id="range"), args=[ast.Name(id=count)]),
            ) if count == _COUNT:
                repeated: list[ast.stmt] = []
                for number in range(self.size):
                    self.indices[index] = number
                    for statement in copy.deepcopy(node.body):
                        result = self.visit(statement)
                        repeated += result if isinstance(result, list) else [result]
                del self.indices[index]
                return repeated
        return self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id == _COUNT:
            return ast.Constant(self.size)
        return ast.Constant(self.indices[node.id]) if node.id in self.indices else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        match node:
            case ast.BinOp(ast.Constant(int(left)), sign, ast.Constant(int(right))):
                if type(sign) in _FOLDED:
                    return ast.Constant(_FOLDED[type(sign)](left, right))
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.value, ast.Name) and node.value.id in self.vectors:
            assert isinstance(node.slice, ast.Constant)
            return ast.Name(f"{node.value.id}_{node.slice.value!r}", node.ctx)
        return node

    def visit_Call(self, node: ast.Call) -> ast.Call:
        node.args = [element for argument in node.args for element in self._elements(argument)]
        return node

    def visit_Return(self, node: ast.Return) -> ast.Return:
        node.value = self._value(node.value)
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.Assign:
        node.value = self._value(node.value)
        node.targets = [self._value(target) for target in node.targets]
        return node

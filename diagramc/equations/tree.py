"""The tree of the systems in a Drake diagram, with their paths and connections."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from functools import cached_property
from typing import Any, TypeAlias

from pydrake.systems.framework import InputPortIndex, OutputPortIndex


class Node:
    """A system in the tree of a diagram: the root, a diagram in it, or a leaf system.

    The path of a system consists of the names of the diagrams that contain the system, and of its
    own name, joined by ``/``. The name of the root is left out, so the root has the empty path.
    """

    def __init__(self, system: Any, parent: Node | None = None, number: int = 0) -> None:
        """Make the node and all nodes below it.

        ``number``: index of the system in its diagram. This number becomes part of the path of a
        system that the user has not named.
        """
        self.system = system
        self.parent = parent
        prefix = f"{parent.path}/" if parent is not None and parent.path else ""
        self.path: str = "" if parent is None else prefix + _label(system, number)
        self.children: dict[str, Node] = {}
        self._drivers: dict[tuple[str, int], tuple[str, int]] = {}
        self._exported: dict[tuple[str, int], int] = {}
        self.observed: list[Node] = []
        """Leaves of the root that have equations although nothing may depend on them."""
        self.is_bypassed = False
        """True if readers of the output port get the signal of the first input port."""
        if not hasattr(system, "connection_map"):
            return
        systems = enumerate(system.GetSystems())
        self.children = {s.get_name(): Node(s, self, number) for number, s in systems}
        for (target, port), (source, output) in system.connection_map().items():
            self._drivers[target.get_name(), int(port)] = (source.get_name(), int(output))
        for index in range(system.num_input_ports()):
            for target, port in system.GetInputPortLocators(InputPortIndex(index)):
                self._exported[target.get_name(), int(port)] = index

    @property
    def name(self) -> str:
        """The path, or the name of the system if the path is empty."""
        return self.path or str(self.system.get_name())

    @property
    def type_name(self) -> str:
        """Name of the system's class, without the scalar type of a template."""
        return type(self.system).__name__.partition("_𝓣")[0]

    @property
    def summary(self) -> str:
        """Name of the system's class, and the first line of its docstring unless Drake wrote it."""
        first = self._docstring.partition("\n")[0].strip()
        return f"{self.type_name}: {first}" if first else f"{self.type_name}."

    @property
    def source(self) -> str:
        """The equations that the docstring of the system's class cites; see `cited_equations`."""
        return cited_equations(self._docstring)

    @property
    def _docstring(self) -> str:
        """The docstring of the system's class or a base class, the first that is not Drake's."""
        binding = ("pydrake", "pybind11", "builtins")
        kinds = (k for k in type(self.system).__mro__ if not k.__module__.startswith(binding))
        texts = ((vars(kind).get("__doc__") or "").strip() for kind in kinds)
        return next(filter(None, texts), "")

    @property
    def has_equations(self) -> bool:
        """True if a state, a margin or an output port of the whole diagram depends on this leaf.

        A margin is the distance of a leaf from a limit that stops a run. So the value is False for
        loggers and for systems that only feed viewers.
        """
        root = self
        while root.parent is not None:
            root = root.parent
        return self in root._needed

    @cached_property
    def _needed(self) -> set[Node]:
        """The leaves below this node that have equations: see `has_equations`."""
        pending = [leaf for leaf in self.leaves() if _has_state_or_margin(leaf.system)]
        pending += [self.output(index)[0] for index in range(self.system.num_output_ports())]
        return upstream([*pending, *self.observed])

    def leaves(self) -> Iterator[Node]:
        """Yield the leaf systems in this system, in the diagram's order; a leaf yields itself."""
        if not hasattr(self.system, "connection_map"):
            yield self
        for child in self.children.values():
            yield from child.leaves()

    @cached_property
    def equation_leaves(self) -> tuple[Node, ...]:
        """The leaf systems that have equations, in the order of the diagram."""
        return tuple(leaf for leaf in self.leaves() if leaf.has_equations)

    def context(self, root_context: Any) -> Any:
        """Return the Context of this system within the Context of the root."""
        if self.parent is None:
            return root_context
        parent_context = self.parent.context(root_context)
        return self.parent.system.GetMutableSubsystemContext(self.system, parent_context)

    def driver(self, index: int) -> tuple[Node, int] | int | None:
        """Return the source of input port ``index`` of this system.

        The source is a leaf with the index of an output port, or the index of an input port of the
        root. The result is None if the input port is not connected.
        """
        *_, (node, kind, port) = self.route(index)
        if kind == "output":
            return node, port
        return port if node.parent is None else None

    def output(self, index: int) -> tuple[Node, int]:
        """Return the leaf that computes output port ``index``, and the index of the leaf's port."""
        *_, (leaf, _, port) = self.output_route(index)
        return leaf, port

    def route(self, index: int) -> Iterator[Port]:
        """Yield the ports from input port ``index`` of this system back to its source.

        The last port is an output port of a leaf, an input port of the root, or an input port that
        is not connected.
        """
        yield self, "input", index
        if self.parent is None:
            return
        key = (self.system.get_name(), index)
        if (source := self.parent._drivers.get(key)) is not None:
            yield from self.parent.children[source[0]].output_route(source[1])
        elif (exported := self.parent._exported.get(key)) is not None:
            yield from self.parent.route(exported)

    def output_route(self, index: int) -> Iterator[Port]:
        """Yield the ports from output port ``index`` of this system back to the source.

        The last port is an output port of a leaf. Behind a bypassed system, the last port can also
        be another source that `route` describes.
        """
        yield self, "output", index
        if self.is_bypassed:
            yield from self.route(0)
        elif hasattr(self.system, "connection_map"):
            system, port = self.system.get_output_port_locator(OutputPortIndex(index))
            yield from self.children[system.get_name()].output_route(int(port))


Port: TypeAlias = tuple[Node, str, int]
"""A port of a system: the system, ``input`` or ``output``, and the index of the port."""


def upstream(leaves: Iterable[Node], ends: Collection[Node] = ()) -> set[Node]:
    """Return ``leaves`` and all leaves that feed them, directly or through others.

    The search goes no further back than the leaves in ``ends``, which are in the result.
    """
    pending, found = [*leaves], set[Node]()
    while pending:
        leaf = pending.pop()
        if leaf not in found:
            found.add(leaf)
            count = 0 if leaf in ends else leaf.system.num_input_ports()
            drivers = map(leaf.driver, range(count))
            pending += [driver[0] for driver in drivers if isinstance(driver, tuple)]
    return found


def cited_equations(text: str) -> str:
    """Return the citations of equations in a text, such as ``Lee et al. 2020, Eq. 12, 13``.

    Citations with authors and year are returned, or all citations if none has authors and year. A
    text without citation gives an empty string.
    """
    work = r"[A-Z][\w-]+(?: et al\.| and [A-Z][\w-]+)?,? \(?\d{4}\)?, "
    numbers = r"Eqs?\. ?\(?\d+(?:\.\d+)?[a-z]?\)?(?:(?:–|-|, | and )\d+(?:\.\d+)?\b)*"
    plain = " ".join(text.split())
    citations = re.findall(f"{work}{numbers}", plain) or re.findall(numbers, plain)
    return "; ".join(dict.fromkeys(citations))


def _label(system: Any, number: int) -> str:
    """Return the name of a system; ``number`` replaces the memory address in a default name."""
    # An address changes from run to run, and with it the key of the machine code.
    return re.sub("@[0-9a-f]{16}$", f"_{number}", str(system.get_name()))


def _has_state_or_margin(system: Any) -> bool:
    return bool(
        system.num_continuous_states()
        or system.num_discrete_state_groups()
        or system.num_abstract_states()
        or callable(getattr(system, "margin", None))
    )

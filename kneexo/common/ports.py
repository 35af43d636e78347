"""The ports of Drake systems, by their names."""

from __future__ import annotations

from typing import Any


def input_ports(system: Any) -> dict[str, Any]:
    """Return a dictionary from name to input port of a system, in the order of the ports."""
    ports = map(system.get_input_port, range(system.num_input_ports()))
    return {port.get_name(): port for port in ports}


def output_ports(system: Any) -> dict[str, Any]:
    """Return a dictionary from name to output port of a system, in the order of the ports."""
    ports = map(system.get_output_port, range(system.num_output_ports()))
    return {port.get_name(): port for port in ports}


def sizes(ports: dict[str, Any]) -> dict[str, int]:
    """Return a dictionary from the name of each port to the number of its elements."""
    return {name: port.size() for name, port in ports.items()}

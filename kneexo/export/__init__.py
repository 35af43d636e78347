"""Exports controller, plant or closed loop of a scenario as code for other programs.

- `target` builds the diagram to export, with names, types and ranges of its ports;
- `firmware` writes the diagram as C for a microcontroller, with test vectors;
- `fmu` packs the diagram as a functional mock-up unit for other simulators.
"""

"""Out of Python: the controller, the plant or the closed loop of a scenario as C and FMU.

- `target` makes the diagram that is exported, and says how its ports look outside;
- `firmware` writes it as C for a microcontroller, with test vectors;
- `fmu` packs it as a functional mock-up unit for other simulators.
"""

"""RK4 on random full-order plants, in small; `benchmarks/rk4_stability.py` has 200 plants."""

from pathlib import Path

PATH = Path(__file__).parents[1] / "benchmarks" / "rk4_stability.py"

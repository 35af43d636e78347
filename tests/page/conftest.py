"""Shared: WebAssembly under wasmtime, as the tests of diagramc run it."""

from pathlib import Path

from elsewhere import module_of

TESTS = Path(__file__).parents[1]
web_run = module_of("wasm_of_pages", TESTS / "diagramc/c/conftest.py").web_run

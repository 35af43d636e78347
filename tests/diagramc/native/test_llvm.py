"""Machine code of IR text, for this processor and for those that are named."""

import ctypes
import gc
import itertools
import re
import warnings
from dataclasses import replace

import pytest

from diagramc.native import llvm
from diagramc.native.llvm import Library, Processor, compile_text, processor
from diagramc.root import variable

ADD_TEXT = """
define void @add(ptr %a, ptr %b, ptr %out) {
  %x = load double, ptr %a
  %y = load double, ptr %b
  %sum = fadd double %x, %y
  store double %sum, ptr %out
  ret void
}
"""
FMA_TEXT = """
declare double @llvm.fma.f64(double, double, double)
define void @polynomial(ptr %a) {
  %x = load double, ptr %a
  %y = call double @llvm.fma.f64(double %x, double %x, double %x)
  store double %y, ptr %a
  ret void
}
"""


def test_a_function_runs_and_outlives_its_library():
    add = Library(compile_text(ADD_TEXT)).function("add", 3)
    gc.collect()
    a, b, total = ctypes.c_double(0.1), ctypes.c_double(0.2), ctypes.c_double()
    add(*map(ctypes.addressof, (a, b, total)))
    assert total.value == 0.1 + 0.2


def test_a_function_of_a_library_is_loaded_once():
    library = Library(compile_text(ADD_TEXT))
    assert library.function("add", 3) is library.function("add", 3)
    with pytest.raises(AssertionError, match="subtract"):
        library.function("subtract", 3)


def test_code_without_optimization_gives_the_same_number():
    plain, code = (compile_text(ADD_TEXT, replace(processor(), level=level)) for level in (0, 3))
    assert plain != code
    numbers = [ctypes.c_double(value) for value in (0.1, 0.2, 0.0)]
    Library(plain).function("add", 3)(*map(ctypes.addressof, numbers))
    assert numbers[2].value == 0.1 + 0.2


def test_text_that_is_no_ir_is_refused():
    with pytest.raises(RuntimeError, match="LLVM IR parsing error"):
        compile_text("define nonsense")


def test_a_processor_without_fused_multiply_add_is_announced():
    if "x86_64" not in llvm.llvm.get_process_triple():
        pytest.skip("needs an x86-64 processor")
    with pytest.warns(UserWarning, match=re.escape("no fused multiply-add (FMA)")):
        compile_text(FMA_TEXT, Processor("x86-64", ""))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        compile_text(FMA_TEXT, Processor("x86-64-v3", ""))


def test_an_environment_variable_names_the_processor(monkeypatch):
    monkeypatch.delenv(variable("CPU"), raising=False)
    monkeypatch.delenv(variable("LLVM_LEVEL"), raising=False)
    here = llvm.processor.__wrapped__()
    assert here.name == llvm.llvm.get_host_cpu_name()
    monkeypatch.setenv(variable("CPU"), "x86-64-v3")
    assert llvm.processor.__wrapped__() == Processor("x86-64-v3", "")
    monkeypatch.setenv(variable("LLVM_LEVEL"), "0")
    assert llvm.processor.__wrapped__() == Processor("x86-64-v3", "", 0)


def test_processors_with_other_code_have_other_keys():
    keys = {Processor(*named).key for named in itertools.product(("a", "b"), ("", "+fma"), (0, 3))}
    assert len(keys) == 8
    assert all(llvm.llvm.get_process_triple() in key for key in keys)

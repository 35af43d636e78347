"""Types of LLVM IR, as LLVM itself reads them."""

import llvmlite.binding as llvm
import pytest

from diagramc.native.types import BOOL, BYTE, DOUBLE, INT, POINTER, Type


@pytest.mark.parametrize("lanes", [1, 2, 8])
@pytest.mark.parametrize("type_", [DOUBLE, INT, BOOL, BYTE, POINTER], ids=str)
def test_llvm_reads_every_type(type_, lanes):
    wide = type_.of(lanes)
    assert (wide.element, wide.lanes) == (type_.element, lanes)
    module = llvm.parse_assembly(f"declare {wide} @f({wide})")
    assert str(module.get_function("f")).strip() == f"declare {wide} @f({wide})"


@pytest.mark.parametrize(
    ("type_", "intrinsic"),
    [
        (DOUBLE, "llvm.sqrt.f64"),
        (DOUBLE.of(8), "llvm.sqrt.v8f64"),
        (INT.of(4), "llvm.ctpop.v4i64"),
        (BYTE, "llvm.ctpop.i8"),
    ],
)
def test_a_suffix_names_the_intrinsic_of_its_type(type_, intrinsic):
    name = f"{intrinsic.rpartition('.')[0]}.{type_.suffix}"
    module = llvm.parse_assembly(f"declare {type_} @{name}({type_})")
    module.verify()  # refuses the name of another type
    assert name == intrinsic


def test_the_number_of_lanes_is_not_that_of_before():
    assert DOUBLE.of(8).of(2) == Type("double", 2)
    assert DOUBLE.of(8).of(1) == DOUBLE

"""Names, types and ranges in C of inputs, outputs and parameters."""

import math
import shutil
import subprocess

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, Integrator, LinearSystem

from diagramc import Interface, read_diagram, source_of
from diagramc.c.interface import c_name, signal_names
from diagramc.equations.equations import Section
from diagramc.errors import CompilationError


def exported(diagram, **options):
    return source_of(read_diagram(diagram, inputs=["u0"]), "model", **options)


def accumulator():
    """A sampled integrator: x⁺ = x + u every 10 ms, and its output 2 x."""
    return LinearSystem(A=[[1.0]], B=[[1.0]], C=[[2.0]], D=[[0.0]], time_period=0.01)


def test_inputs_keep_to_their_range(built):
    interface = Interface({"u0": ["angle_rad"]}, ranges={"angle_rad": (-1.5, 2.5)})
    model = built(exported(accumulator(), interface=interface))
    assert model.init([0.0]) == 0
    statuses = [model.step([value]) for value in (-1.5, 2.5, -1.6, 2.6)]
    assert statuses == [0, 0, 1, 1]


def test_whole_numbers_are_int32(built):
    interface = Interface(integers=frozenset(["u0"]), ranges={"u0": (-2.5, 7.5)})
    source = exported(accumulator(), interface=interface, precision="float")
    model = built(source)
    assert [model.init([0])] + [model.step([v]) for v in (-2, 7, -3, 8)] == [0, 0, 0, 1, 1]
    assert model.get() == [10.0]
    assert "int32_t u0; /* -2 ... 7 */" in source.files()["model.h"]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        *(
            ("law", "law"),
            ("inner/plant", "inner_plant"),
            ("3d", "n3d"),
            ("for", "for_"),
            ("θ", "theta"),
            ("Δλ_ä", "Deltalambda_a"),
            ("x₁–漢", "x1__"),
        ),
        *(
            (word, f"{word}_")
            for word in ("NULL", "NAN", "M_PI", "INT32_MAX", "UINT8_C", "DBL_MAX")
        ),
        *(("_Bool", "_Bool_"), ("M_pi_2", "M_pi_2"), ("KM_PI", "KM_PI"), ("INTEGRAL", "INTEGRAL")),
    ],
)
def test_names_in_c(text, name):
    assert c_name(text) == name


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        *(
            ({"fields": {"u": [name]}}, "must be a C identifier of at most 63 letters")
            for name in ("1x", "a\n*/", "ü b", "", "a" * 64, 3, None)
        ),
        ({"fields": {"u": 3}}, "fields of 'u' = 3: must be a list of names"),
        ({"fields": 3}, "fields = 3: must be a dictionary"),
        ({"integers": 3}, "integers = 3: must be names"),
        ({"ranges": {"u": (1, -1)}}, r"range of 'u' = \(1, -1\): must be a pair of finite numbers"),
        *(
            ({"ranges": {"u": ends}}, "must be a pair of finite numbers")
            for ends in ((math.nan, 1), (0, math.inf), ("a", 1), (1,), 3)
        ),
        ({"failed_outputs": {"y": "a"}}, "'y' after a failure = 'a': must be a number"),
    ],
)
def test_wrong_names_and_ranges_are_refused(arguments, message):
    with pytest.raises(CompilationError, match=message) as error:
        Interface(**arguments)
    assert "\n" not in str(error.value)


def test_a_single_name_is_no_list_of_letters():
    (member,) = Interface({"u": "ab"}).members({"u": 1})
    assert member.name == "ab"


WORDS = (
    *("NULL", "NAN", "INFINITY", "M_PI", "HUGE_VAL", "FP_NAN", "FLT_MAX", "INT32_MAX", "errno"),
    *("_Bool", "try", "throw", "catch", "public", "protected", "friend", "typename", "using"),
    *("and", "or", "not", "xor", "bitand", "explicit", "mutable", "export", "virtual", "wchar_t"),
)


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs the C++ compiler g++")
def test_words_of_c_and_cplusplus_are_no_names(built, tmp_path):
    interface = Interface({"u0": WORDS, "y0": WORDS})
    source = exported(Gain(2.0, len(WORDS)), tick_s=0.1, interface=interface)
    outputs = built(source).replay(np.arange(float(len(WORDS)))[None])
    np.testing.assert_array_equal(outputs[0], 2.0 * np.arange(len(WORDS)))
    header = source.files()["model.h"]
    (tmp_path / "model.h").write_text(header)
    user = '#include <cmath>\n#include <cerrno>\n#include <cstdint>\n#include "model.h"\n'
    (tmp_path / "user.cpp").write_text(user)
    command = ["g++", "-fsyntax-only", "-Wall", "-Werror", "user.cpp"]
    subprocess.run(command, cwd=tmp_path, check=True)


def test_two_fields_of_one_name_are_refused():
    builder = DiagramBuilder()
    integrator = builder.AddNamedSystem("x", Integrator(1))
    builder.ExportInput(integrator.get_input_port(), "u")
    builder.ExportOutput(integrator.get_output_port(), "a b")
    builder.ExportOutput(integrator.get_output_port(), "a-b")
    with pytest.raises(CompilationError, match="a_b: 'a b' and 'a-b' have this name in C; rename"):
        source_of(read_diagram(builder.Build(), inputs=["u"]), "model", tick_s=0.1)


def test_signals_have_the_names_of_leaf_and_port():
    sections = [
        Section("plant/knee: output port icr", "", (4, 5)),
        Section("plant/knee: output port angle", "", (6,)),
        Section("law: output port angle", "", (6,)),  # passes the angle on
        Section("law: output port u", "", (7,)),
        Section("law: time derivatives", "", (8, 9)),
        Section("law: discrete update", "", (10,)),
        Section("law: margin", "", (11,)),
        Section(": output port y", "", (12,)),
        Section("a/filter: output port y-1", "", (13,)),
        Section("b/filter: output port y", "", (14,)),
        Section("a: output port filter_y_1", "", (15,)),  # the name of node 13 in C
        Section(f"a: output port {'y' * 62}", "", (16,)),
        Section(f"a: output port {'y' * 61}", "", (17,)),
    ]
    assert signal_names(sections, "m", {"law_u"}) == {
        4: "knee_icr_0",
        5: "knee_icr_1",
        6: "knee_angle",
        8: "law_rate_0",
        9: "law_rate_1",
        10: "law_next_0",
        11: "law_margin",
        12: "m_y",
        13: "a_filter_y_1",
        14: "b_filter_y",
        17: f"a_{'y' * 61}",
    }

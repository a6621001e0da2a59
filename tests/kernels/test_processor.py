"""Compiler flags follow the processor: one that is there, one that is named, and ones that are imagined."""

import pytest
import warp as wp

from diga3d_warp.kernels.launch import CPU_FLAGS, OPTIONS
from diga3d_warp.kernels.processor import (
    NATIVE,
    TARGET_VARIABLE,
    WIDE,
    compiler_flags,
    flags_here,
    simd_of_machine,
)

X86 = frozenset({"SSE2", "AVX", "F16C", "FMA3", "AVX2"})
WITH_AVX512 = X86 | {"AVX512F", "AVX512VL"}
ARM = frozenset({"NEON", "NEON_FP16", "ASIMD", "SVE"})
WIDTH = """
#if defined(__AVX512F__)
return 512;
#elif defined(__AVX2__)
return 256;
#else
return 0;
#endif
"""
DEFAULT = f"{NATIVE} -mllvm=-inline-threshold=9000"


@pytest.mark.parametrize(
    ("base", "simd", "target", "expected", "wide"),
    [
        (DEFAULT, WITH_AVX512, None, DEFAULT, True),
        (DEFAULT, X86, None, DEFAULT, False),
        (DEFAULT, ARM, None, DEFAULT, False),
        (DEFAULT, frozenset(), None, DEFAULT, False),
        (None, ARM, "", NATIVE, False),
        ("", WITH_AVX512, None, "", False),
        (DEFAULT, WITH_AVX512, "x86-64-v3", "-target-cpu x86-64-v3 -mllvm=-inline-threshold=9000", False),
        (DEFAULT, X86, "x86-64-v4", "-target-cpu x86-64-v4 -mllvm=-inline-threshold=9000", True),
        (DEFAULT, ARM, "apple-m1", "-target-cpu apple-m1 -mllvm=-inline-threshold=9000", False),
    ],
    ids=[
        "AVX-512", "AVX2", "Arm", "unknown", "Arm, no flags set", "generic", "x86-64-v3", "x86-64-v4",
        "named Arm",
    ],
)  # fmt: skip
def test_only_avx512_asks_for_its_width(base, simd, target, expected, wide):
    flags = compiler_flags(base, simd, target)
    assert flags.startswith(expected)
    assert (WIDE in flags) == wide
    others = [flag for flag in flags.removeprefix(expected).split() if flag != WIDE]
    assert others == ["-ffp-contract=fast", "-fno-signed-zeros", "-mreassociate"], "known on every processor"


def test_the_environment_names_a_processor(monkeypatch):
    monkeypatch.setenv(TARGET_VARIABLE, "x86-64-v3")
    assert flags_here(DEFAULT) == compiler_flags(DEFAULT, simd_of_machine(), "x86-64-v3")
    monkeypatch.delenv(TARGET_VARIABLE)
    assert flags_here(DEFAULT) == compiler_flags(DEFAULT, simd_of_machine())


@pytest.mark.skipif(not simd_of_machine() >= X86, reason="no processor with AVX2")
@pytest.mark.parametrize(
    "flags", [CPU_FLAGS, compiler_flags(DEFAULT, X86, "x86-64-v3")], ids=["here", "AVX2"]
)
def test_a_named_processor_is_what_kernels_are_compiled_for(flags):
    @wp.func_native(WIDTH)
    def width() -> int: ...

    @wp.kernel(module="unique", module_options={**OPTIONS, "cpu_compiler_flags": flags})
    def note(widths: wp.array(dtype=int)):
        widths[wp.tid()] = width()

    widths = wp.zeros(1, dtype=int, device="cpu")
    wp.launch(note, 1, [], [widths], device="cpu")
    assert widths.numpy()[0] == (512 if WIDE in flags else 256)

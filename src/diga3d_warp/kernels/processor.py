"""Compiler flags for the processor that kernels run on.

Warp passes the flags to Clang's frontend, on every system and architecture; only `-march=native` it replaces
by the features of this machine's processor. A flag that helps on one architecture only is left out on the
others.
"""

from __future__ import annotations

import os
from collections.abc import Collection

TARGET_VARIABLE = "DIGA3D_CPU"
"""Environment variable that names another processor to compile for, as Clang does. The tests run without
AVX-512 under `DIGA3D_CPU=x86-64-v3`."""

NATIVE = "-march=native"

FUSED = "-ffp-contract=fast"
"""Fused multiply-add: Warp's fast_math emits none on CPU."""

REORDERED = ("-fno-signed-zeros", "-mreassociate")
"""Lets sums over lanes become vector reductions. Never `-ffast-math`: it takes NaN and infinity for
impossible, and with them every guard for unnecessary."""

WIDE = "-mprefer-vector-width=512"
"""Without it LLVM fills half of an AVX-512 register, as processors of 2017 slowed down under full ones."""

WIDE_TARGETS = ("x86-64-v4",)
"""Names of processors with AVX-512 that are no particular one."""


def simd_of_machine() -> frozenset[str]:
    """Names of the SIMD extensions of this machine's processor, as NumPy finds them on every system."""
    from numpy._core import _multiarray_umath

    found = getattr(_multiarray_umath, "__cpu_features__", {})
    return frozenset(name for name, there in found.items() if there)


def compiler_flags(base: str | None, simd: Collection[str], target: str | None = None) -> str:
    """All flags of a CPU kernel.

    Args:
        base: Flags that Warp is configured with; None for its default.
        simd: Extensions of the machine's processor, as in `simd_of_machine`.
        target: Another processor to compile for, by Clang's name; None or "" for the machine's.
    """
    flags = (NATIVE if base is None else base).split()
    wide = NATIVE in flags and "AVX512F" in simd
    if target:
        flags = ["-target-cpu", target, *(flag for flag in flags if flag != NATIVE)]
        wide = target in WIDE_TARGETS
    return " ".join([*flags, FUSED, *([WIDE] if wide else []), *REORDERED])


def flags_here(base: str | None) -> str:
    """The flags for this machine, or for the processor that the environment names."""
    return compiler_flags(base, simd_of_machine(), os.environ.get(TARGET_VARIABLE))

"""Fixtures of the kernel tests."""

import re
from functools import cache

import pytest
import warp as wp


@pytest.fixture(scope="session")
def cuda_code(tmp_path_factory):
    """Function from a kernel to the CUDA code that Warp generates for it; compiles it for a Hopper GPU, too.

    Without comments, which repeat the Python source whatever the branch taken: what is left is compiled in.
    """

    @cache
    def code_of(kernel: wp.Kernel) -> str:
        folder = tmp_path_factory.mktemp("cuda")
        wp.compile_aot_module(kernel.module, device=[], arch=90, module_dir=folder, use_ptx=True)
        (source,), (ptx,) = folder.glob("*.cu"), folder.glob("*.ptx")
        assert f".entry {kernel.key}" in ptx.read_text()
        return re.sub(r"//.*", "", source.read_text())

    return code_of

"""Settings of the whole process."""

import subprocess
import sys

import pytest

GROW_AND_SHRINK = """
from diga3d_warp.process import give_memory_back, tune_process

tune_process()
import gc
import torch
from diga3d_warp.pipelines.machine import peak_mib, reset_peak

held = [torch.ones(1 << 20) for _ in range(64)]  # 256 MiB
del held
gc.collect()
reset_peak()
kept = peak_mib()
give_memory_back()
reset_peak()
print(kept - peak_mib())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's malloc")
def test_freed_memory_stays_until_it_is_given_back():
    done = subprocess.run([sys.executable, "-c", GROW_AND_SHRINK], capture_output=True, text=True, check=True)
    assert float(done.stdout) > 200

"""The demo with the vase's shadow left on: masks mark the vase only, and the removal relights its shadow.

Usage: python benchmarks/demo_with_shadow.py run/demo_with_shadow
"""

import sys
from dataclasses import replace
from pathlib import Path

from diga3d_warp.process import tune_process

if __name__ == "__main__":
    tune_process()
    from diga3d_warp.pipelines.demo import ROOM, run_demo

    run_demo(Path(sys.argv[1]), replace(ROOM, shadows=True))

"""What compositing kernels share: which pixels a thread takes."""

from types import SimpleNamespace

from diga3d_warp.config import TILE, Accuracy, Effects
from diga3d_warp.kernels.blending import Blending, lanes_of


def test_a_fixed_order_on_cuda_takes_one_thread_a_tile():
    cuda = SimpleNamespace(is_cpu=False)
    fixed = Blending.of(Accuracy.STANDARD, Effects(deterministic=True))
    free = Blending.of(Accuracy.STANDARD, Effects())
    assert lanes_of(cuda, fixed).region == TILE and lanes_of(cuda, free).region == 1
    assert fixed == free, "the same kernels on CPU"

"""The z-buffer of reprojection: (float32 depth bits << 32 | index), and the smallest key wins.

So the nearest surface wins, at equal depth the first in the source, whatever the order of drawing. Depths are
positive, and bits of positive floats sort like integers.
"""

import warp as wp

UNCOVERED = wp.constant(wp.int64(0x7FFFFFFFFFFFFFFF))
"""Key of a pixel that nothing covers."""


@wp.func
def key_of(depth: wp.float64, index: int):
    """Key of surface `index` at a depth."""
    depth_bits = wp.int64(wp.cast(wp.float32(depth), wp.int32))
    return (depth_bits << wp.int64(32)) | wp.int64(index)


@wp.func
def index_of(key: wp.int64):
    """Index of the winner; the pixel must not be `UNCOVERED`."""
    return int(key & wp.int64(0x7FFFFFFF))

"""A child process that converts a splat with GaussForge, so that a damaged file can crash no one else.

    python gaussforge_child.py SOURCE TARGET MEMORY < input > output

SOURCE and TARGET are GaussForge's names of formats, MEMORY the most that the process may take [bytes].
Exit code 3, with a reason as the last line of stderr, if GaussForge refuses the input.
"""

from __future__ import annotations

import os
import sys

REFUSED = 3


def main(source: str, target: str, memory: str) -> int:
    """Convert stdin to stdout."""
    _limit_memory(int(memory))
    output = os.dup(1)
    os.dup2(2, 1)  # GaussForge prints to stdout
    import gaussforge

    answer = gaussforge.GaussForge().convert(sys.stdin.buffer.read(), source, target)
    if "error" in answer:
        print(f"\n{answer['error']}", file=sys.stderr)
        return REFUSED
    with os.fdopen(output, "wb") as stream:
        stream.write(answer["data"])
    return 0


def _limit_memory(most: int) -> None:
    """Bound the address space, where the system can (Linux)."""
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

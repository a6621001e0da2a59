"""`python -m diga3d_warp.cli`, where the command is not on the path."""

import sys

from diga3d_warp.cli import main

sys.exit(main())

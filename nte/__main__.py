"""python -m nte: the same as the `nte` command."""

import sys

from nte.cli import main

sys.exit(main())

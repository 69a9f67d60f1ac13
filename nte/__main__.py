"""The `nte` command as `python -m nte`."""

import sys

from nte.cli import main

sys.exit(main())

"""``python -m cell`` is the command ``mikado``."""

import sys

from cell.cli import main

sys.exit(main())

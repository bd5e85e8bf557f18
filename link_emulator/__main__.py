"""``python -m link_emulator``."""

import sys

from link_emulator.cli import main

sys.exit(main())

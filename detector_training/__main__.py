"""``python -m detector_training``."""

from __future__ import annotations

from detector_training.commands.app import main

if __name__ == "__main__":
    main()

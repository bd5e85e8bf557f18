"""``python -m detector_training``."""

from __future__ import annotations

from detector_training.cli import main

if __name__ == "__main__":
    main()

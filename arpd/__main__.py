"""`python -m arpd`."""

from __future__ import annotations

import sys

from arpd.cli import main

sys.exit(main())

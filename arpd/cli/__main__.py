"""`python -m arpd.cli`."""

from __future__ import annotations

import sys

from arpd.cli.main import main

sys.exit(main())

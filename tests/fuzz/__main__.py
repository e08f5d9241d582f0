"""``python tests/fuzz``: the whole, a part of it, or one case."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzz.command_line import main

raise SystemExit(main())

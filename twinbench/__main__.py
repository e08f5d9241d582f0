"""``python -m twinbench``."""

from twinbench.bench.cli.main import main

raise SystemExit(main())

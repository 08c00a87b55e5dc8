"""`python -m agile_jax.cli`: the `agile` command."""

import sys

from agile_jax.cli import main

sys.exit(main())

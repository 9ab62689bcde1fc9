"""`python -m experiments.cli`: the `mantis` command where its script is not on the path."""

import sys

from experiments.cli.main import main

sys.exit(main())

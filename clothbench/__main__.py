"""`python -m clothbench`."""

import sys

from clothbench.cli.commands import main

sys.exit(main())

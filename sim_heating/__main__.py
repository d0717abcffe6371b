"""python -m sim_heating is the command sim-heating."""

import sys

from sim_heating.cli import main

sys.exit(main())

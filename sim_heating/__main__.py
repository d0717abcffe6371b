"""python -m sim_heating is the command sim-heating."""

import sys

from sim_heating.cli import main

if __name__ == "__main__":  # a process started beside this one imports it again
    sys.exit(main())

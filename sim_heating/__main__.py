"""The command sim-heating, as itself and as python -m sim_heating."""

import sys


def main() -> int:
    """Run the command; its modules take a second to load, and an interrupt meanwhile is told like any other."""
    try:
        from sim_heating import cli
    except KeyboardInterrupt:
        print("interrupted: nothing was begun", file=sys.stderr)
        return 1
    return cli.main()


if __name__ == "__main__":  # a process started beside this one imports it again
    sys.exit(main())

"""Entry point of the command `sim-heating` and of `python -m sim_heating`."""

import sys


def main() -> int:
    """Run the command; an interrupt while its modules load is reported in one line, as any later one."""
    try:
        from sim_heating import cli
    except KeyboardInterrupt:
        print("interrupted: nothing was begun", file=sys.stderr)
        return 1
    return cli.main()


if __name__ == "__main__":  # processes that a command starts import this module again
    sys.exit(main())

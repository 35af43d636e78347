"""The entry point of ``kneexo`` and ``python -m kneexo``."""

import signal
import sys


def main() -> int:
    """Run the command line; return the exit code.

    Ctrl-C never prints a traceback, not even while kneexo is being imported. Modules in the working
    directory can be imported, as they can with ``python -m``.
    """
    if "" not in sys.path and not sys.flags.safe_path:
        sys.path.append("")  # last, so that a file there hides no installed module
    try:
        from kneexo.command_line.main import main as command

        return command()
    except KeyboardInterrupt:
        print("kneexo: interrupted", file=sys.stderr)
        return 130
    finally:  # a second Ctrl-C ends Python at once: nothing needs clean-up
        signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())

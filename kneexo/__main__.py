"""The command ``kneexo`` and ``python -m kneexo``."""

import signal
import sys


def main() -> int:
    """Run the command line and return its exit code; Ctrl-C outside it prints no traceback.

    Modules of the working directory can be imported, as with ``python -m``.
    """
    if "" not in sys.path and not sys.flags.safe_path:
        sys.path.append("")  # last, so that a file there hides no installed module
    try:
        from kneexo.command_line.main import main as command

        return command()
    except KeyboardInterrupt:
        print("kneexo: interrupted", file=sys.stderr)
        return 130
    finally:  # the end of Python has nothing to clear away
        signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())

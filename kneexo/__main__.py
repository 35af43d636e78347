"""The command ``kneexo`` and ``python -m kneexo``."""

import signal
import sys


def main() -> int:
    """Run `kneexo.cli.main`; Ctrl-C before and after it is no traceback either.

    Modules of the working directory can be imported, as with ``python -m``.
    """
    if "" not in sys.path and not sys.flags.safe_path:
        sys.path.append("")  # last: a file there replaces no module of others
    try:
        from kneexo.cli import main as command

        return command()
    except KeyboardInterrupt:
        print("kneexo: interrupted", file=sys.stderr)
        return 130
    finally:  # the end of Python has nothing to clear away
        signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())

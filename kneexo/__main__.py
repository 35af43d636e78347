"""``python -m kneexo``."""

import sys

from kneexo.cli import main

if __name__ == "__main__":
    sys.exit(main())

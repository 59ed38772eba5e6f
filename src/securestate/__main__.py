"""`python -m securestate` is the command line."""

import sys

from securestate.cli import main

if __name__ == "__main__":
    sys.exit(main())

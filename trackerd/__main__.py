import sys

from trackerd.cli import main

sys.exit(main())

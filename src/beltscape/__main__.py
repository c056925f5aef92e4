"""``python -m beltscape``."""

from beltscape.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())

"""`python -m msb` is `msb`."""

from msb.cli import main

if __name__ == "__main__":
    main()

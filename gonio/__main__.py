"""`python -m gonio`: the same as the command `gonio`."""

from gonio.cli import main

if __name__ == "__main__":
    main()

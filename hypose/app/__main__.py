"""`python -m hypose.app`: the command line, for environments without console scripts."""

from hypose.app.cli import main

if __name__ == "__main__":
    main()

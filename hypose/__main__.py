"""`python -m hypose`: the command line, where the folder of scripts is not on the PATH."""

from hypose.app.__main__ import main

if __name__ == "__main__":
    main()

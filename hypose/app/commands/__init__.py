"""Commands of the command line: they read options, and run jobs or print a sentence."""

"""App: the command line, overlay videos and reports."""

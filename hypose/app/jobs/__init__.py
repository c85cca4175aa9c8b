"""Work of commands after their options are known: from files to files."""
